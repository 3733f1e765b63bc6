"""A series of bounded length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Thinned(Generic[T]):
    """Keeps every ``stride``-th item of a stream, and doubles the stride when there are too many.

    Args:
        limit: how many are kept at most (at least 2).

    Attributes:
        seen: how many came.
        stride: 1 as long as none was left out.

    """

    def __init__(self, limit: int) -> None:
        assert limit >= 2, limit
        self.seen, self.stride = 0, 1
        self._limit = limit
        self._items: list[T] = []

    def add(self, item: T) -> None:
        """Take the next item."""
        if self.seen % self.stride == 0:
            if len(self._items) == self._limit:
                self._items = self._items[::2]
                self.stride *= 2
            if self.seen % self.stride == 0:
                self._items.append(item)
        self.seen += 1

    def __iter__(self) -> Iterator[T]:
        return iter(self._items)

    def since(self, first: int) -> list[T]:
        """Those kept from a number on."""
        return self._items[first:]

    def __len__(self) -> int:
        return len(self._items)
