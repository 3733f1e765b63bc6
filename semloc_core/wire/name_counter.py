"""Counts of names that other machines sent: they may send any number of them, of any length."""

from __future__ import annotations

from collections import Counter

from semloc_core.text import short_repr
from semloc_core.wire.codec import one_line

MAX_NAMES = 1000
MAX_LENGTH = 100
MAX_THINGS = 100_000
OTHERS = "(others)"
"""What names beyond the first thousand are counted under."""


@short_repr
class NameCounter(Counter[str]):
    """Names -> of how many things each was seen, in bounded memory; each name printable and cut to 100 characters.

    Things beyond the first hundred thousand are not counted: a count is a lower bound then.
    """

    def __init__(self) -> None:
        super().__init__()
        self._things: set[int] = set()

    def see(self, name: str, thing: str) -> None:
        """Count a thing that was seen under a name, unless it was counted before."""
        key = hash((name, thing))
        if key in self._things or len(self._things) >= MAX_THINGS:
            return
        self._things.add(key)
        shown = name if len(name) <= MAX_LENGTH and name.isprintable() else one_line(name[:MAX_LENGTH])
        if shown not in self and len(self) >= MAX_NAMES:
            shown = OTHERS
        self[shown] += 1

    def clear(self) -> None:
        """Forget all."""
        super().clear()
        self._things.clear()
