"""A map's objects and free space, laid out for verification: made once for a map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from semloc_core.geodesic import ranges
from semloc_core.graph_arrays import Floats, GraphArrays, Ints
from semloc_core.layout.config import LayoutConfig

Floats32 = NDArray[np.float32]

ROOM_CELL_M = 0.5
ROOM_LAYER_M = 1.0
MOST_CELLS = 1 << 26
CELLS_ANYWAY, CELLS_PER_PLACE = 1 << 20, 1 << 12
"""A building whose free space has more cells than these allow (its coordinates are absurd) is judged by its objects
alone: many such buildings must not fill the memory either."""
MOST_NEAR = 1024
"""Objects that count around a place of the map, the nearest: no building has as many, and their number is a cost."""
MOST_IN_SQUARE = 4 * MOST_NEAR
"""Objects in a square as wide as the reach that are looked at at all, the first by id."""
BLOCK_ROWS = 256
_BLOCK_PAIRS = 1 << 16
_CELLS_PER_REACH = 2
_STRIDE = 1 << 32
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


class MappedLayout:
    """All buildings of a map.

    Args:
        graphs: one a building.
        rows: for each building the indices of its places that are in the map, in the order of the map's rows.
        n_classes: C.
        config: how far surroundings count.
        weights: for each building the probability that each of its objects is still there; None: all surely are.

    """

    def __init__(
        self,
        graphs: Sequence[GraphArrays],
        rows: Sequence[Ints],
        n_classes: int,
        config: LayoutConfig,
        weights: Sequence[Floats] | None = None,
    ) -> None:
        self.n_classes, self.config = n_classes, config
        self.positions: Floats = np.concatenate(
            [np.zeros((0, 3)), *(g.place_positions[r] for g, r in zip(graphs, rows, strict=True))]
        )
        self.building = np.repeat(np.arange(len(graphs)), [len(r) for r in rows]).astype(np.int64)
        ends = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)
        self.rows = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        """The rows of each building."""
        self._places = [g.place_positions for g in graphs]
        self._rooms: dict[int, Room | None] = {}
        known = [(g.object_classes >= 0) & _uncrowded(g.object_positions, config.reach_m) for g in graphs]
        self.object_positions: Floats = np.concatenate(
            [np.zeros((0, 3)), *(g.object_positions[k] for g, k in zip(graphs, known, strict=True))]
        )
        self.object_classes: Ints = np.concatenate(
            [np.zeros(0, np.int64), *(g.object_classes[k] for g, k in zip(graphs, known, strict=True))]
        )
        stays = [np.ones(g.n_objects) for g in graphs] if weights is None else weights
        self.detected: Floats = config.detected * np.concatenate(
            [np.zeros(0), *(w[k] for w, k in zip(stays, known, strict=True))]
        )
        """(K,) probability that each object is there and is detected."""
        first = np.concatenate([[0], np.cumsum([k.sum() for k in known])]).astype(np.int64)
        self._object_runs = [slice(int(a), int(b)) for a, b in pairwise(first)]
        self._count_classes()

    @classmethod
    def joined(cls, parts: Sequence[MappedLayout]) -> MappedLayout:
        """What all the buildings of several maps make, one map after another: equal to reading them together.

        Args:
            parts: at least one, of the same classes and configuration; all that they have ready is taken over.

        """
        found = cls([], [], parts[0].n_classes, parts[0].config)
        rows = np.cumsum([0, *(part.n_places for part in parts)]).tolist()
        objects = np.cumsum([0, *(len(part.object_classes) for part in parts)]).tolist()
        buildings = np.cumsum([0, *(len(part.rows) for part in parts)]).tolist()
        found.positions = np.concatenate([part.positions for part in parts])
        found.building = np.concatenate([part.building + b for part, b in zip(parts, buildings, strict=False)])
        found.object_positions = np.concatenate([part.object_positions for part in parts])
        found.object_classes = np.concatenate([part.object_classes for part in parts])
        found.detected = np.concatenate([part.detected for part in parts])
        starts, near = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        for part, row, object_, building in zip(parts, rows, objects, buildings, strict=False):
            found.rows += [slice(run.start + row, run.stop + row) for run in part.rows]
            found._object_runs += [slice(run.start + object_, run.stop + object_) for run in part._object_runs]
            found._places += part._places
            found._rooms.update({building + number: part.room(number) for number in range(len(part.rows))})
            start, there = part.objects_near
            starts.append(start[1:] + starts[-1][-1])
            near.append(there + object_)
        found.objects_near = np.concatenate(starts), np.concatenate(near)
        found._count_classes()
        return found

    def _count_classes(self) -> None:
        n_classes = self.n_classes
        counts = np.bincount(self.object_classes, minlength=n_classes).astype(np.float64)
        # A class that no map has can be invented too.
        frequency = (counts / max(counts.sum(), 1.0) + 0.1 / n_classes) / 1.1
        self.invented: Floats = self.config.invented * frequency
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

    def prepare(self) -> None:
        """Make all that queries need: none of them waits for it."""
        _ = self.objects_near
        for building in range(len(self._places)):
            self.room(building)

    @cached_property
    def objects_near(self) -> tuple[Ints, Ints]:
        """(M + 1,) starts and (K,) objects in reach of each place and a little more, by place: `MOST_NEAR` at most."""
        reach = self.config.reach_m + 4 * self.config.off_m + 2 * self.config.spread_m
        sizes, found = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        for rows, run in zip(self.rows, self._object_runs, strict=True):
            near = Nearby(self.positions[rows], self.object_positions[run], reach, self.config.floor_m + 1.5)
            for first, last, i, j, metres in near.blocks():
                i, j = _nearest(i - first, j, metres)
                sizes.append(np.bincount(i, minlength=last - first))
                found.append(j + run.start)
        return np.cumsum(np.concatenate(sizes)), np.concatenate(found)


class Nearby:
    """All pairs of (A, 3) and (B, 3) points that are near in the plane and in height, block by block.

    Costs about the number of pairs: only points in cells beside one another are compared.

    Args:
        a, b: the points, metres.
        reach_m: in the plane.
        floor_m: in height.

    """

    def __init__(self, a: Floats, b: Floats, reach_m: float, floor_m: float) -> None:
        self._a, self._reach2, self._floor = np.ascontiguousarray(a.T), reach_m**2, floor_m
        side = reach_m / _CELLS_PER_REACH
        cell_a, cell_b = (np.floor(np.clip(x[:, :2] / side, -1e9, 1e9)).astype(np.int64) for x in (a, b))
        key = cell_b[:, 0] * _STRIDE + cell_b[:, 1]
        self._order = np.argsort(key, kind="stable").astype(np.int64)
        self._b, key = np.ascontiguousarray(b[self._order].T), key[self._order]
        # A column of cells is one run of the sorted points.
        columns = np.arange(-_CELLS_PER_REACH, _CELLS_PER_REACH + 1)
        middle = (cell_a[:, :1] + columns) * _STRIDE + cell_a[:, 1:]
        self._low = np.searchsorted(key, middle - _CELLS_PER_REACH, side="left").astype(np.int64)
        self._size = np.searchsorted(key, middle + _CELLS_PER_REACH, side="right").astype(np.int64) - self._low

    @property
    def compared(self) -> int:
        """How many pairs are looked at: what it costs."""
        return int(self._size.sum())

    def blocks(self) -> Iterator[tuple[int, int, Ints, Ints, Floats]]:
        """First and last row of ``a`` (half open), and of the pairs: index in ``a``, in ``b``, metres in the plane.

        By ``a``, then by cell, then by ``b``; a block has `BLOCK_ROWS` rows at most.
        """
        ends = np.cumsum(self._size.sum(axis=1))
        first = 0
        while first < len(ends):
            done = int(ends[first - 1]) if first else 0
            last = int(np.searchsorted(ends, done + _BLOCK_PAIRS, side="right"))
            last = min(max(last, first + 1), first + BLOCK_ROWS, len(ends))
            sizes = self._size[first:last]
            i = np.repeat(np.arange(first, last), sizes.sum(axis=1))
            at = ranges(self._low[first:last].ravel(), sizes.ravel())
            x, y, z = (there[at] - here[i] for here, there in zip(self._a, self._b, strict=True))
            d2 = x * x + y * y
            near = np.flatnonzero((d2 <= self._reach2) & (np.abs(z) <= self._floor))
            yield first, last, i[near], self._order[at[near]], np.sqrt(d2[near])
            first = last


def _nearest(i: Ints, j: Ints, metres: Floats) -> tuple[Ints, Ints]:
    """Of pairs by ``i``, the `MOST_NEAR` nearest of each; of those as near the first by ``j``."""
    size = np.bincount(i) if len(i) else np.zeros(1, dtype=np.int64)
    if size.max() <= MOST_NEAR:
        return i, j
    order = np.lexsort((j, np.round(metres, 6), i))
    rank = np.arange(len(i)) - np.repeat(np.cumsum(size) - size, size)
    kept = order[rank < MOST_NEAR]
    return i[kept], j[kept]


def _uncrowded(points: Floats, side_m: float) -> NDArray[np.bool_]:
    """(N,) which of (N, 3) points are among the first `MOST_IN_SQUARE` of their square of the plane."""
    kept = np.ones(len(points), dtype=np.bool_)
    if len(points) > MOST_IN_SQUARE:
        squares = np.floor(points[:, :2] / side_m)
        order = np.lexsort(squares.T)
        ordered = squares[order]
        first = np.flatnonzero(np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)])
        size = np.diff(np.r_[first, len(points)])
        kept[order] = np.arange(len(points)) - np.repeat(first, size) < MOST_IN_SQUARE
    return kept
