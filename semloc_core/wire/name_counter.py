"""Counts of names that other machines sent: they may send any number of them, of any length."""

from __future__ import annotations

from collections import Counter

from semloc_core.wire.codec import one_line

MAX_NAMES = 1000
MAX_LENGTH = 100
OTHERS = "(others)"
"""What names beyond the first thousand are counted under."""


class NameCounter(Counter[str]):
    """Names -> how often each was seen, in bounded memory; each name printable and cut to 100 characters."""

    def see(self, name: str) -> None:
        """Count a name once more."""
        shown = name if len(name) <= MAX_LENGTH and name.isprintable() else one_line(name[:MAX_LENGTH])
        if shown not in self and len(self) >= MAX_NAMES:
            shown = OTHERS
        self[shown] += 1
