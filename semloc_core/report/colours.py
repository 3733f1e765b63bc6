"""Colours that a colour-blind reader can tell apart (Okabe and Ito 2008), each with a mark that does without colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
GREY = "#8C8C8C"
INK = "#0A0B0C"
"""Text, axes and lines; in the page it becomes the page's own text colour, so that it reads on dark and on light."""
RIGHT, WRONG = GREEN, VERMILLION
SCALE = "cividis"
"""Colour map for quantities: made for colour-blind readers, and it rises in lightness."""
OTHER = "other classes"


@dataclass(frozen=True)
class Style:
    """How one series is told from the others: colour, marker, line, hatch."""

    colour: str
    marker: str
    line: str | tuple[int, tuple[int, ...]] = "-"
    hatch: str = ""


_STYLES = (
    Style(BLUE, "o", "-", ""),
    Style(ORANGE, "s", "--", "//"),
    Style(GREEN, "^", "-.", ".."),
    Style(PURPLE, "D", ":", "xx"),
    Style(SKY, "v", (0, (5, 1)), "\\\\"),
    Style(VERMILLION, "P", (0, (3, 1, 1, 1)), "--"),
    Style(YELLOW, "*", (0, (1, 1)), "++"),
)
_REST = Style(GREY, ".", (0, (1, 3)), "")


def styles(names: Sequence[str]) -> dict[str, Style]:
    """A style for each name in order; from the eighth on all share one, because no reader tells more apart."""
    return {name: _STYLES[i] if i < len(_STYLES) else _REST for i, name in enumerate(names)}


def grouped(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """The names that get a style of their own, and those that share `OTHER`'s."""
    return list(names[: len(_STYLES)]), list(names[len(_STYLES) :])


OTHER_STYLE = _REST
