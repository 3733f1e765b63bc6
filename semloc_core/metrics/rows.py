"""What every evaluation returns: flat rows, each with ``method`` and ``scope`` and its figures by name."""

from __future__ import annotations

from collections.abc import Callable

Row = dict[str, str | int | float | None]
"""``method``: an encoder, a baseline, an explainer or a peer; ``scope``: ``all``, a building, a split, a distance."""

Progress = Callable[[int, int, str], None]
"""Called with what is done, of how much, and a few words."""


def no_progress(done: int, total: int, words: str) -> None:
    """Tell nobody."""
