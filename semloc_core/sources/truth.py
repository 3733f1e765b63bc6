"""Pairs what was recorded with where the robot truly was: the nearest stamp within a tolerance, in bounded memory."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

from semloc_core.sources.bag import Truth

TOLERANCE_S = 0.05
"""How far apart, in seconds, the stamps of an answer and of its ground truth may be by default."""
_TRUTHS = 20_000
"""True poses that are kept at most: those of the latest stamps."""

T = TypeVar("T")


class TruthMatcher(Generic[T]):
    """Gives items back in the order they came, each with the true pose nearest to its stamp, whichever comes first.

    An item is held back until a true pose of its stamp has come, one with a later stamp has, or too many wait.

    Args:
        tolerance_ns: how far apart stamps may be.
        waiting: items held back at most.

    Attributes:
        seen: true poses that came.
        matched: items that got one.
        largest_ns: how far apart the stamps of a pair were at most.

    """

    def __init__(self, tolerance_ns: int = round(TOLERANCE_S * 1e9), waiting: int = 100) -> None:
        self._tolerance, self._most = tolerance_ns, waiting
        self._waiting: deque[tuple[int, T]] = deque()
        self._truths: dict[int, Truth] = {}
        self._stamps: list[int] = []
        self._latest: int | None = None
        self.seen = self.matched = self.largest_ns = 0

    def item(self, stamp_ns: int, item: T) -> Iterator[tuple[T, Truth | None]]:
        """Take an item in; give what is due."""
        self._waiting.append((stamp_ns, item))
        return self._due()

    def truth(self, truth: Truth) -> Iterator[tuple[T, Truth | None]]:
        """Take a true pose in; give what is due."""
        self.seen += 1
        self._latest = truth.stamp_ns
        if truth.stamp_ns not in self._truths:
            insort(self._stamps, truth.stamp_ns)
        self._truths[truth.stamp_ns] = truth
        if len(self._stamps) > _TRUTHS:
            for stamp in self._stamps[: _TRUTHS // 2]:
                del self._truths[stamp]
            del self._stamps[: _TRUTHS // 2]
        return self._due()

    def rest(self) -> Iterator[tuple[T, Truth | None]]:
        """What still waits; there will be no more."""
        return self._due(to=0)

    def _due(self, to: int | None = None) -> Iterator[tuple[T, Truth | None]]:
        most = self._most if to is None else to
        while self._waiting:
            stamp_ns, item = self._waiting[0]
            passed = self._latest is not None and self._latest > stamp_ns
            if not (stamp_ns in self._truths or passed or len(self._waiting) > most or to is not None):
                return
            self._waiting.popleft()
            yield item, self._nearest(stamp_ns)

    def _nearest(self, stamp_ns: int) -> Truth | None:
        row = bisect_left(self._stamps, stamp_ns)
        near = self._stamps[max(row - 1, 0) : row + 1]
        if not near:
            return None
        best = min(near, key=lambda stamp: abs(stamp - stamp_ns))
        if abs(best - stamp_ns) > self._tolerance:
            return None
        self.matched += 1
        self.largest_ns = max(self.largest_ns, abs(best - stamp_ns))
        return self._truths[best]
