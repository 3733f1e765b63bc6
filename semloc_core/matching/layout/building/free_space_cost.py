"""What it costs to know a place where a building of the map has no room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.text import short_repr

Floats32 = NDArray[np.float32]
Complex = NDArray[np.complex128]

ROOM_CELL_M = 0.5
ROOM_LAYER_M = 1.0
MOST_CELLS = 1 << 26
CELLS_ANYWAY, CELLS_PER_PLACE = 1 << 20, 1 << 12
"""A building whose free space has more cells than these allow (its coordinates are absurd) is judged by its objects
alone: many such buildings must not fill the memory either."""
FAR_M = 2.7
"""From so far on a place in a wall is no further from the map's free space."""


@short_repr
@dataclass(frozen=True, eq=False)
class Room:
    """What it costs to know a place somewhere, cell by cell: nothing in the map's free space, more the further off.

    Args:
        low: (3,) float64, the corner of the first cell but for the rim, metres.
        cost: (X, Y, Z) float32, log-likelihood lost; beyond all cells it is that of the nearest one.

    """

    low: Floats
    cost: Floats32

    @classmethod
    def none(cls) -> Room:
        """Room everywhere: nobody knows better."""
        return cls(np.zeros(3), np.zeros((1, 1, 1), dtype=np.float32))


class Rooms:
    """The free space of several buildings.

    Args:
        rooms: one a building; None where it can't be laid out.

    """

    def __init__(self, rooms: Sequence[Room | None]) -> None:
        known = [room or Room.none() for room in rooms]
        self._low = np.array([room.low for room in known]).reshape(-1, 3)
        self._shape = np.array([room.cost.shape for room in known], dtype=np.int64).reshape(-1, 3)
        self._cost: Floats32 = np.concatenate([np.zeros(0, np.float32), *(room.cost.ravel() for room in known)])
        sizes = [room.cost.size for room in known]
        self._first = np.cumsum([0, *sizes]).astype(np.int64)

    def lost(self, building: Ints, turn: Complex, origin: Floats, places: Floats) -> Floats:
        """(T,) cost of k places that a robot knows, were it in each of T poses.

        Args:
            building: (T,) of each pose.
            turn: (T,) complex of length one.
            origin: (T, 3) metres, where the robot is.
            places: (k, 3) metres from there, by its heading.

        """
        if compiled():
            from semloc_core.matching.layout.compiled.against import lost

            return lost(
                building,
                np.stack([turn.real, turn.imag], axis=1),
                np.ascontiguousarray(origin),
                np.ascontiguousarray(places),
                self._low,
                self._shape,
                self._first,
                self._cost,
                RIM,
                (ROOM_CELL_M, ROOM_LAYER_M),
            )
        low, size = self._low[building], self._shape[building].astype(np.float64)
        x, y, z = places.T
        ground = np.vstack([x, y, np.ones(len(x))])
        c, s, off = turn.real, turn.imag, (origin - low) / _CELL + RIM
        # Counted in float64, where whole numbers are exact, and in place: there are many points.
        at = np.stack([c / ROOM_CELL_M, -s / ROOM_CELL_M, off[:, 0]], axis=1) @ ground
        _into(at, size[:, 0])
        cells = np.stack([s / ROOM_CELL_M, c / ROOM_CELL_M, off[:, 1]], axis=1) @ ground
        _into(cells, size[:, 1])
        at *= size[:, 1, None]
        at += cells
        # Floors are level: their heights are on the brink of a layer, and are rounded as they were for the map.
        cells = (np.add.outer(origin[:, 2], z) - low[:, 2, None]) / ROOM_LAYER_M
        np.floor(cells, out=cells)
        cells += RIM
        _into(cells, size[:, 2])
        at *= size[:, 2, None]
        at += cells
        at += self._first[building][:, None]
        found: Floats = self._cost[at.astype(np.int64)].sum(axis=1, dtype=np.float64)
        return found


RIM = 2
"""Cells around all that anything is written to, lest a rounding writes to the last: what lies beyond is like them."""
_CELL = np.array([ROOM_CELL_M, ROOM_CELL_M, ROOM_LAYER_M])


def _into(cells: Floats, size: Floats) -> None:
    """Whole numbers of the cells that (T, k) points are in, or of the nearest, among (T,) of each frame; in place."""
    np.maximum(cells, 0.0, out=cells)
    np.minimum(cells, size[:, None] - 1.0, out=cells)
    np.floor(cells, out=cells)


def room_of(places: Floats, config: LayoutConfig) -> Room | None:
    """The free space that (P, 3) places stand for; None where it has too many cells."""
    outside = config.room_weight * _lost(FAR_M, config)
    margin = np.ceil(FAR_M / _CELL).astype(np.int64)
    low = places.min(axis=0) - margin * _CELL
    shape = np.floor((places.max(axis=0) - low) / _CELL) + margin + 1 + 2 * RIM
    if not np.isfinite(shape).all() or shape.prod() > min(MOST_CELLS, CELLS_ANYWAY + CELLS_PER_PLACE * len(places)):
        return None
    cost = np.full(shape.astype(np.int64), outside, dtype=np.float32)
    x, y, z = (np.floor((places - low) / _CELL).astype(np.int64) + RIM).T
    steps = [np.arange(-m, m + 1) for m in margin]
    offsets = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    # A layer up or down may be a hand's breadth: only what lies between two layers is surely apart.
    apart = np.maximum(np.abs(offsets) - np.array([0, 0, 1]), 0)
    metres = np.linalg.norm(apart * _CELL, axis=1)
    # The furthest first: what is nearer is written over it.
    for i in np.argsort(-metres, kind="stable"):
        if metres[i] < FAR_M:
            dx, dy, dz = offsets[i]
            cost[x + dx, y + dy, z + dz] = config.room_weight * _lost(float(metres[i]), config)
    return Room(low, cost)


def _lost(metres: float, config: LayoutConfig) -> float:
    beyond = metres - config.room_within_m
    return 0.0 if beyond <= 0 else min(3.0, 0.5 + 1.5 * beyond / config.room_within_m)
