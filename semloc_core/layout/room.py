"""What it costs to know a place where a building of the map has no room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph_arrays import Floats
from semloc_core.layout.config import LayoutConfig

Floats32 = NDArray[np.float32]

ROOM_CELL_M = 0.5
ROOM_LAYER_M = 1.0
MOST_CELLS = 1 << 26
CELLS_ANYWAY, CELLS_PER_PLACE = 1 << 20, 1 << 12
"""A building whose free space has more cells than these allow (its coordinates are absurd) is judged by its objects
alone: many such buildings must not fill the memory either."""
FAR_M = 2.7
"""From so far on a place in a wall is no further from the map's free space."""


@dataclass(frozen=True, eq=False)
class Room:
    """What it costs to know a place somewhere, cell by cell: nothing in the map's free space, more the further off.

    Args:
        low: (3,) float64, the corner of the first cell, metres.
        cost: (X, Y, Z) float32, log-likelihood lost.
        outside: the same beyond all cells.

    """

    low: Floats
    cost: Floats32
    outside: float

    def at(self, points: Floats) -> Floats32:
        """(…,) cost at (…, 3) points, metres."""
        cells = np.floor((points - self.low) / _CELL).astype(np.int64)
        shape = np.array(self.cost.shape)
        inside = ((cells >= 0) & (cells < shape)).all(axis=-1)
        x, y, z = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        found: Floats32 = np.where(inside, self.cost[x, y, z], np.float32(self.outside))
        return found


_CELL = np.array([ROOM_CELL_M, ROOM_CELL_M, ROOM_LAYER_M])


def room_of(places: Floats, config: LayoutConfig) -> Room | None:
    """The free space that (P, 3) places stand for; None where it has too many cells."""
    outside = config.room_weight * _lost(FAR_M, config)
    margin = np.ceil(FAR_M / _CELL).astype(np.int64)
    low = places.min(axis=0) - margin * _CELL
    shape = np.floor((places.max(axis=0) - low) / _CELL) + margin + 1
    if not np.isfinite(shape).all() or shape.prod() > min(MOST_CELLS, CELLS_ANYWAY + CELLS_PER_PLACE * len(places)):
        return None
    cost = np.full(shape.astype(np.int64), outside, dtype=np.float32)
    x, y, z = np.floor((places - low) / _CELL).astype(np.int64).T
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
    return Room(low, cost, outside)


def _lost(metres: float, config: LayoutConfig) -> float:
    beyond = metres - config.room_within_m
    return 0.0 if beyond <= 0 else min(3.0, 0.5 + 1.5 * beyond / config.room_within_m)
