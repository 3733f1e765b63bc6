"""A map's buildings side by side, laid out for verification."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import STOREYS_NEAR, Floats, Ints, separate, storeys_at
from semloc_core.matching.layout.building.free_space_cost import Rooms
from semloc_core.matching.layout.building.layout import LayoutPart
from semloc_core.matching.layout.building.objects_by_place import Around
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.compiled.tables import Ints32, MapTable
from semloc_core.matching.layout.config import LayoutConfig


class MappedLayout:
    """All buildings of a map.

    Args:
        parts: its buildings, in the order of the map's rows, all made for the same classes and options; not kept.
        n_classes: C.
        config: these options.

    Attributes:
        positions: (M, 3) the map's places, metres; each building in its own frame.
        building: (M,) the number of each place's building.
        start: (B + 1,) where each building's places begin.
        storey: (M,) the number of each place's storey, counted through all buildings.
        object_positions: (K, 3) objects of all buildings, metres.
        object_classes: (K,) of these.
        object_ids: K ids, each of its own building.
        detected: (K,) probability that each object is there and is detected.
        invented: (C,) objects invented, per m² and class.
        odds: (K,) a seen object's odds of being this one, exactly where it is mapped, and not invented.
        rooms: the free space of each building.
        cells: (M,) numbers of the cells of `APART_M` that the places are in.
        around: the objects around each place.
        table: the same as compiled functions read it.

    """

    def __init__(self, parts: Sequence[LayoutPart], n_classes: int, config: LayoutConfig) -> None:
        self.config, self.n_classes = config, n_classes
        for building in parts:
            assert building.n_classes == n_classes, (building.n_classes, n_classes)
            assert building.config == config, (building.config, config)
        none = np.zeros((0, 3))
        # Column by column: they are read so.
        self.positions: Floats = np.asfortranarray(np.concatenate([none, *(b.positions for b in parts)]))
        self.building: Ints = np.repeat(np.arange(len(parts)), [len(b) for b in parts]).astype(np.int64)
        self.storey = separate(self.building, np.concatenate([np.zeros(0, np.int64), *(b.storeys for b in parts)]))
        self.start = np.searchsorted(self.building, np.arange(len(parts) + 1)).astype(np.int64)
        # A building's storeys are numbered one after another.
        some = np.flatnonzero(np.diff(self.start))
        self._lowest, self._storeys = np.zeros(len(parts), dtype=np.int32), np.zeros(len(parts), dtype=np.int64)
        self._lowest[some] = np.minimum.reduceat(self.storey, self.start[some]) if len(some) else 0
        self._storeys[some] = np.maximum.reduceat(self.storey, self.start[some]) + 1 if len(some) else 0
        self._storeys[some] -= self._lowest[some]
        self.object_positions: Floats = np.asfortranarray(np.concatenate([none, *(b.object_positions for b in parts)]))
        self.object_classes: Ints = np.concatenate([np.zeros(0, np.int64), *(b.object_classes for b in parts)])
        self.object_ids: tuple[str, ...] = tuple(id_ for b in parts for id_ in b.object_ids)
        self.detected: Floats = np.concatenate([np.zeros(0), *(b.detected for b in parts)])
        counts = np.bincount(self.object_classes, minlength=n_classes).astype(np.float64)
        # A class that no map has can be invented too.
        frequency = (counts / max(counts.sum(), 1.0) + 0.1 / n_classes) / 1.1
        self.rooms = Rooms([b.room for b in parts])
        self.around = Around.joined([b.around for b in parts], [len(b.object_positions) for b in parts])
        self.invented: Floats = config.invented * frequency
        self.cells: Ints = _numbered([b.cells for b in parts])
        self.odds: Floats = self.detected / (2 * np.pi * config.spread_m**2) / self.invented[self.object_classes]
        self.table = self._table()

    @property
    def n_places(self) -> int:
        """M."""
        return len(self.positions)

    def storeys_of(self, points: Floats, rows: Ints) -> list[list[int]]:
        """The storeys (numbers of `storey`) that (A, 3) points, metres, of (A,) rows' buildings may be said to be on.

        The likeliest of each first.
        """
        if (self._storeys[self.building[rows]] == 1).all():
            return [[on] for on in self.storey[rows].tolist()]
        if not compiled():
            return [self._storeys_at(point, row) for point, row in zip(points, rows.tolist(), strict=True)]
        from semloc_core.matching.layout.compiled.storeys import storeys_of

        at = np.ascontiguousarray(points)
        found = storeys_of(self.table, at, rows, self.storey, self._lowest, self._storeys, MATCH_RADIUS_M, STOREYS_NEAR)
        return [[on for on in each if on >= 0] for each in found.tolist()]

    def _storeys_at(self, point: Floats, row: int) -> list[int]:
        first, last = self.start[self.building[row]], self.start[self.building[row] + 1]
        storey = self.storey[first:last]
        if storey.min() == storey.max():
            return [int(storey[0])]
        # What is far off in the plane is no storey there.
        off = np.abs(self.positions[first:last, :2] - point[:2])
        near: NDArray[np.bool_] = off.max(axis=1) <= MATCH_RADIUS_M
        near[row - first] = True
        return storeys_at(point, self.positions[first:last][near], storey[near].astype(np.int64))

    def _table(self) -> MapTable:
        (x, y, z), (object_x, object_y, object_z), around = self.positions.T, self.object_positions.T, self.around
        return MapTable(
            x=x,
            y=y,
            z=z,
            building=self.building,
            place_start=self.start,
            start=around.start,
            objects=around.objects,
            classes=around.classes,
            metres=around.metres,
            bearing=around.bearing,
            up=around.up,
            object_x=object_x,
            object_y=object_y,
            object_z=object_z,
            odds=self.odds,
            detected=self.detected,
        )

    def weights(self, likely: Floats) -> Floats:
        """(n, C) what the odds of an object to be a mapped one of each class are to be multiplied by.

        What an object is said to be, p(c), speaks for c by p(c) / frequency(c), and `odds` have the frequency in them.
        What has no name may be anything, by its frequency; of an object that has one, only classes that it is said to
        be are looked at.

        Args:
            likely: (n, C + 1) as a fragment's.

        """
        named = likely[:, :-1]
        meant = (named > 0) | ~(named > 0).any(axis=1, keepdims=True)
        found: Floats = np.where(meant, named + likely[:, -1:] * self.invented / self.config.invented, 0.0)
        return found

    def kinds(self, classes: Ints) -> tuple[Ints32, Ints32]:
        """(n,) a small number for each of some classes, and (C,) the same number by class; -1 for all other classes."""
        of_class = np.full(self.n_classes, -1, dtype=np.int32)
        of_class[classes] = 0
        found = np.flatnonzero(of_class == 0)
        of_class[found] = np.arange(len(found))
        return of_class[classes], of_class


def _numbered(parts: Sequence[Ints]) -> Ints:
    """Numbers of several buildings' cells, each building's after those of the last one."""
    found, first = [np.zeros(0, dtype=np.int64)], 0
    for cells in parts:
        found.append(cells + first)
        first += int(cells.max(initial=-1)) + 1
    return np.concatenate(found)
