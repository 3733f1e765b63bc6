"""A map's objects and free space, laid out for verification: made once for a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph_arrays import Floats, GraphArrays, Ints
from semloc_core.layout.config import LayoutConfig

Floats32 = NDArray[np.float32]

ROOM_CELL_M = 0.5
ROOM_LAYER_M = 1.0
MOST_CELLS = 1 << 26
"""A building whose free space has more cells (its coordinates are absurd) is judged by its objects alone."""
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
    """The free space that (P, 3) places stand for; None where it has more than `MOST_CELLS` cells."""
    outside = config.room_weight * _lost(FAR_M, config)
    margin = np.ceil(FAR_M / _CELL).astype(np.int64)
    low = places.min(axis=0) - margin * _CELL
    shape = np.floor((places.max(axis=0) - low) / _CELL) + margin + 1
    if not np.isfinite(shape).all() or shape.prod() > MOST_CELLS:
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


class MappedLayout:
    """All buildings of a map.

    Args:
        graphs: one a building.
        rows: for each building the indices of its places that are in the map, in the order of the map's rows.
        n_classes: C.
        config: how far surroundings count.

    """

    def __init__(
        self, graphs: Sequence[GraphArrays], rows: Sequence[Ints], n_classes: int, config: LayoutConfig
    ) -> None:
        self.n_classes, self.config = n_classes, config
        self.positions: Floats = np.concatenate(
            [np.zeros((0, 3)), *(g.place_positions[r] for g, r in zip(graphs, rows, strict=True))]
        )
        self.building = np.repeat(np.arange(len(graphs)), [len(r) for r in rows]).astype(np.int64)
        self._places = [g.place_positions for g in graphs]
        self._rooms: dict[int, Room | None] = {}
        known = [g.object_classes >= 0 for g in graphs]
        self.object_positions: Floats = np.concatenate(
            [np.zeros((0, 3)), *(g.object_positions[k] for g, k in zip(graphs, known, strict=True))]
        )
        self.object_classes: Ints = np.concatenate(
            [np.zeros(0, np.int64), *(g.object_classes[k] for g, k in zip(graphs, known, strict=True))]
        )
        first = np.concatenate([[0], np.cumsum([k.sum() for k in known])]).astype(np.int64)
        self._object_runs = [slice(int(a), int(b)) for a, b in pairwise(first)]
        counts = np.bincount(self.object_classes, minlength=n_classes).astype(np.float64)
        # A class that no map has can be invented too.
        frequency = (counts / max(counts.sum(), 1.0) + 0.1 / n_classes) / 1.1
        self.invented: Floats = config.invented * frequency
        """(C,) objects invented, per m² and class."""

    @property
    def n_places(self) -> int:
        """M."""
        return len(self.positions)

    def free_space(self, building: int) -> Floats:
        """(P, 3) the places of a building, also those that are not in the map, metres."""
        return self._places[building]

    def room(self, building: int) -> Room | None:
        """A building's free space, made when it is first asked for."""
        if building not in self._rooms:
            self._rooms[building] = room_of(self._places[building], self.config)
        return self._rooms[building]

    @cached_property
    def objects_near(self) -> tuple[Ints, Ints]:
        """(M + 1,) starts and (K,) objects in reach of each place and a little more, by place, then object."""
        reach = self.config.reach_m + 4 * self.config.off_m + 2 * self.config.spread_m
        start, found = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        for building, run in enumerate(self._object_runs):
            rows = np.flatnonzero(self.building == building)
            pairs = pairs_within(self.positions[rows], self.object_positions[run], reach, self.config.floor_m + 1.5)
            sizes = np.bincount(pairs[0], minlength=len(rows))
            start.append(start[-1][-1] + np.cumsum(sizes))
            found.append(pairs[1] + run.start)
        return np.concatenate(start), np.concatenate(found)


def pairs_within(a: Floats, b: Floats, reach_m: float, floor_m: float) -> tuple[Ints, Ints]:
    """Indices of all pairs of (A, 3) and (B, 3) points that are near in the plane and in height, by a, then b.

    Costs about the number of pairs: only points in cells beside one another are compared.
    """
    none = np.zeros(0, dtype=np.int64)
    if not len(a) or not len(b):
        return none, none
    cell_a, cell_b = (np.floor(np.clip(x[:, :2] / reach_m, -1e9, 1e9)).astype(np.int64) for x in (a, b))
    by_cell: dict[tuple[int, int], list[int]] = {}
    for i, (x, y) in enumerate(cell_b.tolist()):
        by_cell.setdefault((x, y), []).append(i)
    cells, inverse = np.unique(cell_a, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    order = np.argsort(inverse, kind="stable")
    ends = np.cumsum(np.bincount(inverse, minlength=len(cells)))
    found_a, found_b = [none], [none]
    for (x, y), end, begin in zip(cells.tolist(), ends, np.r_[0, ends[:-1]], strict=True):
        beside = [i for dx in (-1, 0, 1) for dy in (-1, 0, 1) for i in by_cell.get((x + dx, y + dy), ())]
        if not beside:
            continue
        mine, theirs = order[begin:end], np.array(sorted(beside), dtype=np.int64)
        off = a[mine][:, None] - b[theirs]
        close = (off[..., 0] ** 2 + off[..., 1] ** 2 <= reach_m**2) & (np.abs(off[..., 2]) <= floor_m)
        near_a, near_b = np.nonzero(close)
        found_a.append(mine[near_a])
        found_b.append(theirs[near_b])
    all_a, all_b = np.concatenate(found_a), np.concatenate(found_b)
    by_a = np.lexsort((all_b, all_a))
    return all_a[by_a], all_b[by_a]
