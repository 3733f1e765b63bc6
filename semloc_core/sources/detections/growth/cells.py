"""What lies near what, without looking at all: keys by cell of a metre."""

from __future__ import annotations

import math
from collections.abc import Iterator

from semloc_core.graph import Floats
from semloc_core.wire import Position


class Cells:
    """Keys by cell of a metre in the plane."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], set[str]] = {}

    def put(self, key: str, position: Floats) -> None:
        """Note where a thing of this key is."""
        self._cells.setdefault(_cell(position), set()).add(key)

    def drop(self, key: str, position: Floats) -> None:
        """Forget it there."""
        row = self._cells[cell := _cell(position)]
        row.discard(key)
        if not row:
            del self._cells[cell]

    def near(self, position: Floats, radius_m: float) -> Iterator[str]:
        """Keys at most so far away, and some more; in no particular order."""
        (left, low), (right, high) = _cell(position - radius_m), _cell(position + radius_m)
        if (right - left + 1) * (high - low + 1) > len(self._cells):
            for row in self._cells.values():
                yield from row
            return
        for x in range(left, right + 1):
            for y in range(low, high + 1):
                yield from self._cells.get((x, y), ())


def _cell(position: Floats) -> tuple[int, int]:
    return math.floor(position[0]), math.floor(position[1])


def distance(a: Floats, b: Floats) -> float:
    """Between two points (3,), m."""
    return math.dist(a.tolist(), b.tolist())


def ordered(a: str, b: str) -> tuple[str, str]:
    """A way, whichever end comes first."""
    return (a, b) if a < b else (b, a)


def rounded(values: Floats) -> Position:
    """To millimetres, as positions and sizes are written."""
    x, y, z = (round(value, 3) + 0.0 for value in values.tolist())
    return x, y, z
