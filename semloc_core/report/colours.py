"""Colours that a colour-blind reader can tell apart (Okabe and Ito 2008), each with a mark that does without colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from semloc_core.text import short_repr

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


@short_repr
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
    """A style for each series in order; from the eighth on all share one, because no reader tells more apart."""
    return {name: _STYLES[i] if i < len(_STYLES) else _REST for i, name in enumerate(names)}


OTHER_STYLE = _REST

_MARKERS = (*(style.marker for style in _STYLES), "X", "p", "h", "<", ">")
_HATCHES = (*(style.hatch for style in _STYLES), "||", "oo", "**", "OO", "---")
OWN = 14
"""Classes that a picture shows each by itself; those after them share `OTHER`'s look, so that a legend can be read."""


def class_style(index: int) -> Style:
    """The look of a class by its place in the labelspace, the same in every picture of whatever made it.

    Colours come round after seven classes with another mark and another hatch each time, so that of 84 classes no two
    look alike; a place that is none (-1) has `OTHER`'s look.
    """
    if index < 0:
        return OTHER_STYLE
    turn, at = divmod(index, len(_STYLES))
    turned = (at + turn) % len(_MARKERS)
    return Style(_STYLES[at].colour, _MARKERS[turned], _STYLES[at].line, _HATCHES[turned])


@short_repr
@dataclass(frozen=True)
class ClassLooks:
    """How the classes look that a report shows.

    Args:
        labelspace: all classes of the labelspace; their order gives the looks.
        order: those that the report shows, those first that matter most: `own` goes by it.

    """

    labelspace: Sequence[str]
    order: Sequence[str]

    @property
    def own(self) -> list[str]:
        """Classes that are shown each by itself."""
        return list(self.order[:OWN])

    @property
    def rest(self) -> list[str]:
        """Classes that are shown together, as `OTHER`."""
        return list(self.order[OWN:])

    def __getitem__(self, name: str) -> Style:
        return class_style(self.labelspace.index(name) if name in self.labelspace else -1)
