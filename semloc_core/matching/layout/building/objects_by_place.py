"""The objects around each place of a map: who they are, and where from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints, ranges
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.text import short_repr

Floats32 = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class Around:
    """Objects in reach of M places, by place: 20 bytes for each.

    Args:
        start: (M + 1,) where each place's objects begin.
        objects: (L,) int32, numbers of objects.
        classes: (L,) int32, their classes.
        metres: (L,) float32, how far each is in the plane.
        bearing: (L,) float32, radians: in which direction.
        up: (L,) float32, metres above the place.

    """

    start: Ints
    objects: NDArray[np.int32]
    classes: NDArray[np.int32]
    metres: Floats32
    bearing: Floats32
    up: Floats32

    @classmethod
    def of(cls, start: Ints, objects: Ints, places: Floats, positions: Floats, classes: Ints) -> Around:
        """What (L,) objects by place are to (M, 3) places; positions (K, 3), metres, and classes are of all objects."""
        x, y, up = (positions[objects] - places[np.repeat(np.arange(len(places)), np.diff(start))]).T.astype(np.float32)
        return cls(
            start,
            objects.astype(np.int32),
            classes[objects].astype(np.int32),
            np.sqrt(x * x + y * y),
            np.arctan2(y, x),
            up,
        )

    @classmethod
    def joined(cls, parts: Sequence[Around], objects: Sequence[int]) -> Around:
        """Of several buildings, one after another, each with so many objects."""
        sizes = [np.zeros(1, np.int64), *(np.diff(part.start) for part in parts)]
        first = np.cumsum([0, *objects]).astype(np.int32)
        numbers = [part.objects + before for part, before in zip(parts, first, strict=False)]
        return cls(
            np.cumsum(np.concatenate(sizes)),
            np.concatenate([np.zeros(0, np.int32), *numbers]),
            np.concatenate([np.zeros(0, np.int32), *(part.classes for part in parts)]),
            *(
                np.concatenate([np.zeros(0, np.float32), *(getattr(part, name) for part in parts)])
                for name in ("metres", "bearing", "up")
            ),
        )

    def of_places(self, rows: Ints) -> tuple[Ints, Ints]:
        """Of (T,) rows: for each object around them which of the rows it is around, and where in the table it is."""
        start = self.start[rows]
        size = self.start[rows + 1] - start
        return np.repeat(np.arange(len(rows)), size), ranges(start, size)


def around_m(config: LayoutConfig) -> float:
    """How far objects are looked for around a place: the robot stands beside it, and objects are displaced."""
    return config.reach_m + 4 * config.off_m + 2 * config.spread_m


def sums(index: Ints, values: Floats | Floats32, n: int) -> Floats:
    """(n,) sums of (K,) values by index."""
    # Of nothing at all numpy makes integers.
    return np.bincount(index, values, n).astype(np.float64, copy=False)
