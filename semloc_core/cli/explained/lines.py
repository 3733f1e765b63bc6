"""The parts of what is printed: a word in the margin, lines beside it."""

from __future__ import annotations

from collections.abc import Callable

from rich.text import Text

from semloc_core.cli.shared.screen import console
from semloc_core.graph import short_id
from semloc_core.wire import Match, PlaceMatches

NAMED = 4
"""Classes, objects and rivals named in a line at most; ``--long`` names more."""


def head(word: str, rest: str) -> None:
    """The first line of a part."""
    console.print(Text.assemble((f"{word:8s}", "bold"), f" {rest}"))


def line(text: str) -> None:
    """A further line of a part."""
    console.print(f"{'':8s} {text}")


def place_of(map_: str | None, place: str | None) -> str:
    """A place of a map in words."""
    return f"{map_}, place {short_id(place) if place is not None else '–'}"


def print_what(matches: PlaceMatches, asked: str, reason: str, more: Callable[[Match], str]) -> Match | None:
    """What and where: the best place, and ``more`` of it; None where there is none."""
    best = matches.matches[0] if matches.matches else None
    if best is None:
        head("WHAT", f"{matches.status}: {reason or 'no place of the map'}")
    else:
        place = f"{place_of(best.map, best.place)}{more(best)}"
        head("WHAT", f"{matches.status}: {place}{f'; {reason}' if reason else ''}")
    head("WHERE", asked)
    return best
