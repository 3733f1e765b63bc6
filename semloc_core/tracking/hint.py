"""Somebody says about where the robot is: what is looked at narrows to that, for some metres walked."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.map_database import LoadedMap
from semloc_core.text import short_repr

LASTS_M = 10.0
"""Metres walked after which a hint is forgotten: by then the robot has seen for itself."""


@short_repr
@dataclass(frozen=True)
class Hint:
    """About where the robot is.

    Args:
        buildings: names of buildings that it may be in.
        position: x and y, metres, in the building's frame; of all storeys.
        radius_m: how far from there it may be, metres.

    """

    buildings: Collection[str]
    position: tuple[float, float]
    radius_m: float

    def allows(self, loaded: LoadedMap, walked_m: float) -> NDArray[np.bool_]:
        """(M,) bool, the places that the robot can be at so many metres after the hint."""
        found = np.zeros(loaded.n_places, dtype=bool)
        for building in set(self.buildings) & set(loaded.buildings):
            rows = loaded.rows_of(building)
            off = np.linalg.norm(loaded.positions[rows][:, :2] - np.array(self.position), axis=1)
            found[rows] = off <= self.radius_m + walked_m
        return found


class Hinted:
    """A hint, for as long as it holds.

    Args:
        hint: what was said.
        walked: metres that the robot had walked by then.

    """

    def __init__(self, hint: Hint, walked: float) -> None:
        self._hint: Hint | None = hint
        self._walked = walked

    def allowed(self, loaded: LoadedMap, walked: float) -> NDArray[np.bool_] | None:
        """(M,) bool, where the robot can be by it after so many metres in all; None: anywhere."""
        since = walked - self._walked
        if self._hint is None or since > LASTS_M:
            self._hint = None
            return None
        allowed = self._hint.allows(loaded, since)
        return allowed if allowed.any() else None
