"""Which places of a map lie near a place on its storey: a hashed grid, built once for a map, numpy only."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
_REMEMBERED = 2**14  # answers, and blocks of nine cells


class RadiusIndex:
    """Fixed-radius neighbours among the places of all storeys of a map.

    Args:
        positions: (M, 3) float64, metres; each building in its own frame.
        storey: (M,) integer, counted through all buildings; places of different storeys are never near.
        radius_m: the radius, metres.

    """

    def __init__(self, positions: NDArray[np.float64], storey: NDArray[np.int32], radius_m: float) -> None:
        self._positions = positions
        self._storey = storey
        self._radius = radius_m
        # A robot asks for the same places again and again; the map does not change.
        self._known: dict[int, Ints] = {}
        self._blocks: dict[tuple[int, int, int], tuple[Ints, NDArray[np.float64]]] = {}

    @cached_property
    def _cells(self) -> tuple[dict[tuple[int, int, int], tuple[int, int]], Ints, Ints]:
        """Places sorted by (storey, x cell, y cell), and where each cell's run begins and ends."""
        xy = np.floor(self._positions[:, :2] / self._radius).astype(np.int64)
        keys = np.column_stack([self._storey.astype(np.int64), xy])
        order = np.lexsort((keys[:, 2], keys[:, 1], keys[:, 0]))
        ordered = keys[order]
        starts = np.flatnonzero(np.r_[True, np.any(ordered[1:] != ordered[:-1], axis=1)])
        ends = np.r_[starts[1:], len(ordered)]
        cells = {
            (int(b), int(x), int(y)): (int(s), int(e))
            for (b, x, y), s, e in zip(ordered[starts], starts, ends, strict=True)
        }
        return cells, order, keys

    def within(self, row: int) -> Ints:
        """Rows at most the radius away from place ``row``, itself among them, in rising order; not to be changed."""
        found = self._known.get(row)
        if found is None:
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            found = self._known[row] = self._within(row)
        return found

    def _within(self, row: int) -> Ints:
        _, _, keys = self._cells
        b, x, y = keys[row].tolist()
        near, positions = self._around((b, x, y))
        offset = positions - self._positions[row]
        found: Ints = near[np.einsum("ij,ij->i", offset, offset) <= self._radius**2]
        return found

    def _around(self, cell: tuple[int, int, int]) -> tuple[Ints, NDArray[np.float64]]:
        """Rows of a cell and the eight around it, in rising order, and their positions (m)."""
        found = self._blocks.get(cell)
        if found is None:
            cells, order, _ = self._cells
            b, x, y = cell
            runs = [cells.get((b, x + dx, y + dy)) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
            near = np.sort(np.concatenate([order[r[0] : r[1]] for r in runs if r is not None]))
            if len(self._blocks) >= _REMEMBERED:
                self._blocks.clear()
            found = self._blocks[cell] = (near, self._positions[near])
        return found
