"""Points that are near one another, without comparing all with all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints, ranges

MOST_NEAR = 1024
"""Objects that count around a place of the map, the nearest: no building has as many, and their number is a cost."""
MOST_IN_SQUARE = 4 * MOST_NEAR
"""Objects in a square as wide as the reach that are looked at at all, the first by id."""
BLOCK_ROWS = 256
_BLOCK_PAIRS = 1 << 16
_CELLS_PER_REACH = 2
_STRIDE = 1 << 32


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


def nearest(i: Ints, j: Ints, metres: Floats) -> tuple[Ints, Ints]:
    """Of pairs by ``i``, the `MOST_NEAR` nearest of each; of those as near the first by ``j``."""
    size = np.bincount(i) if len(i) else np.zeros(1, dtype=np.int64)
    if size.max() <= MOST_NEAR:
        return i, j
    order = np.lexsort((j, np.round(metres, 6), i))
    rank = np.arange(len(i)) - np.repeat(np.cumsum(size) - size, size)
    kept = order[rank < MOST_NEAR]
    return i[kept], j[kept]


def uncrowded(points: Floats, side_m: float) -> NDArray[np.bool_]:
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
