"""How the frame of a robot's graph drifts: as a random walk in the way walked, and how much."""

from __future__ import annotations

import math

TURN_RAD, SHIFT_M = math.radians(0.5), 0.03
"""Standard deviations of the turn about the robot and of the shift per axis, m, of a usual frame after a metre."""
ENOUGH = 20
"""Objects written anew before their moves say how much a frame drifts."""
MOST = 25.0
"""More drift than this is not believed: objects are moved, or loops closed."""
MOVED_M = 0.5
"""An object that is written so far from where it was was moved, or taken for another one."""


class DriftMeter:
    """Measures drift by how far objects move that are seen again and written anew."""

    def __init__(self) -> None:
        self._moved = self._expected = 0.0
        self._count = 0

    def add(self, moved_m: float, metres: float, away_m: float) -> None:
        """Take in an object that was written anew.

        Args:
            moved_m: how far it moved in the plane.
            metres: walked since it was written before, > 0.
            away_m: how far it is from the robot.

        """
        if moved_m > MOVED_M:
            return
        self._moved += moved_m**2
        self._expected += metres * expected_square(away_m)
        self._count += 1

    @property
    def drift(self) -> float | None:
        """As a variance: 1 is that of `TURN_RAD` and `SHIFT_M`; None while too little was written anew."""
        return min(self._moved / self._expected, MOST) if self._count >= ENOUGH else None


def expected_square(away_m: float) -> float:
    """Mean square of how far an object moves in the plane in a usual frame, after a metre, m²."""
    return 2 * SHIFT_M**2 + (TURN_RAD * away_m) ** 2
