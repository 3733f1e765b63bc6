"""The traversability graph with small integers for place ids: twice as fast to search, where most of it is searched."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from semloc_core.wire import Position


class PlaceIndex:
    """A mirror of a graph's ``neighbours`` that is kept up to date row by row.

    Attributes:
        slots: place id -> its slot; slots of removed places are given out again.
        cells: slot -> area (m²) of the free space that a place stands for: the square of its shortest edge; 0 where
            it has none.

    """

    def __init__(self, neighbours: Mapping[str, Mapping[str, float]], positions: Mapping[str, Position]) -> None:
        self.slots: dict[str, int] = {}
        self.cells: list[float] = []
        self._rows: list[list[tuple[int, float]]] = []  # slot -> (neighbour's slot, metres)
        self._free: list[int] = []
        self._asked: tuple[str, float, NDArray[np.float64]] | None = None  # the last answer, until something changes
        self._positions: NDArray[np.float64] = np.full((64, 3), np.nan)
        self.update(neighbours, positions, neighbours)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(slots, 3) float64, metres; not a number where a slot has no place. Not to be changed, nor kept."""
        return self._positions[: len(self._rows)]

    def update(
        self,
        neighbours: Mapping[str, Mapping[str, float]],
        positions: Mapping[str, Position],
        touched: Iterable[str],
    ) -> None:
        """Read the rows of these places again.

        Args:
            neighbours: the graph as it is now: place -> {neighbouring place: length (m)}.
            positions: place -> where it is, metres.
            touched: places added, moved or removed, and the ends of edges that came, went or changed their length.

        """
        self._asked = None
        slots, rows = self.slots, self._rows
        present: list[str] = []
        for place in touched:
            if place in neighbours:
                present.append(place)
                if place not in slots:
                    slots[place] = self._free.pop() if self._free else len(rows)
                    if slots[place] == len(rows):
                        rows.append([])
                        self.cells.append(0.0)
            elif place in slots:
                slot = slots.pop(place)
                rows[slot] = []
                self._positions[slot] = np.nan
                self._free.append(slot)
        while len(self._positions) < len(rows):
            self._positions = np.concatenate([self._positions, np.full_like(self._positions, np.nan)])
        for place in present:
            near = neighbours[place]
            self._positions[slots[place]] = positions[place]
            rows[slots[place]] = [(slots[other], length) for other, length in near.items()]
            side = min(near.values(), default=0.0)
            self.cells[slots[place]] = side * side

    def distances(self, source: str, radius_m: float) -> NDArray[np.float64]:
        """Geodesic distance of every slot from a place, by Dijkstra's algorithm; as `semloc_core.graph.geodesic.ball`.

        Args:
            source: a place of the graph.
            radius_m: bound in metres, inclusive; a slot that is not reached within it has a larger number.

        Returns:
            (slots,) float64, not to be changed.

        """
        if self._asked is None or self._asked[0] != source or self._asked[1] != radius_m:
            self._asked = source, radius_m, np.array(self._distances(source, radius_m), dtype=np.float64)
        return self._asked[2]

    def _distances(self, source: str, radius_m: float) -> list[float]:
        rows = self._rows
        best = [math.nextafter(radius_m, math.inf)] * len(rows)
        start = self.slots[source]
        best[start] = 0.0
        heap = [(0.0, start)]
        while heap:
            distance, slot = heappop(heap)
            if distance > best[slot]:
                continue  # an older, longer way to what has been settled since
            for other, length in rows[slot]:
                through = distance + length
                if through < best[other]:
                    best[other] = through
                    heappush(heap, (through, other))
        return best
