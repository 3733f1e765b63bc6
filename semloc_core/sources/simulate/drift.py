"""The frame of a run drifts: odometry errs, and without loop closures what is seen is written in the frame as is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from semloc_core.graph import SHIFT_M, TURN_RAD, Floats


@dataclass(frozen=True)
class Frame:
    """Where a run's frame has the building: turned about gravity by ``yaw``, then shifted.

    Args:
        yaw: radians.
        shift: metres.

    """

    yaw: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def of(self, points: Floats) -> Floats:
        """Points (…, 3) of the building, metres, as written in this frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        found: Floats = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array(self.shift)
        return found

    def drifted(self, here: Floats, metres: float, rng: np.random.Generator, scale: float = 1.0) -> Frame:
        """The frame after a step: it turns about the robot, and shifts.

        Args:
            here: (3,) where the robot is in the building, metres.
            metres: the step's length.
            rng: always draws four numbers.
            scale: of both deviations.

        """
        spread = scale * math.sqrt(metres)
        turn = float(rng.normal()) * spread * TURN_RAD
        shift = rng.normal(size=3) * spread * SHIFT_M
        about = self.of(here)
        moved = about + shift - Frame(turn).of(about - np.array(self.shift))
        x, y, z = moved.tolist()
        return Frame(self.yaw + turn, (x, y, z))
