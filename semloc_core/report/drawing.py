"""A matplotlib figure as SVG text for a page, or as PNG: the same bytes for the same figure."""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from semloc_core.report.colours import INK

WIDTH = 4.6
"""Inches. Drawn this narrow, a figure's text is still read when it is scaled to a telephone's width."""
TEXT = 11.5
"""Size of a figure's text, points; smaller text would make it scroll on a telephone."""
LEAST_PX = 11.0
"""No text of a figure is smaller than this on any screen, in pixels of a page: a narrower screen scrolls the figure."""
# Any: which keys and values matplotlib's stubs allow differs from version to version.
_STYLE: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": TEXT,
    "axes.titlesize": TEXT,
    "axes.labelsize": TEXT,
    "xtick.labelsize": TEXT,
    "ytick.labelsize": TEXT,
    "legend.fontsize": TEXT,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "hatch.linewidth": 0.6,
    # A class may be called `$x_2$`: names are text, not formulae.
    "text.parse_math": False,
    # Text stays text: it can be read aloud, searched, and tested.
    "svg.fonttype": "none",
    "svg.hashsalt": "semloc",
    "path.simplify": True,
}


@contextmanager
def figure(height: float, width: float = WIDTH) -> Iterator[Figure]:
    """A new figure in the report's style; draw in it inside the ``with`` block.

    Args:
        height: inches.
        width: inches.

    """
    with matplotlib.rc_context(_STYLE):
        drawn = Figure(figsize=(width, height), layout="constrained")
        drawn.patch.set_alpha(0.0)
        yield drawn


def bare(axes: Axes) -> None:
    """Lines of a grid in place of a frame."""
    axes.patch.set_alpha(0.0)
    axes.grid(True, color=INK, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)


def folded(words: str, width: int = 44) -> str:
    """Words for a title or an axis, in lines that a figure `WIDTH` wide holds."""
    return "\n".join(textwrap.wrap(words, width))


def points(values: ArrayLike) -> NDArray[np.float64]:
    """(n, 2), also of none."""
    return np.asarray(values, dtype=np.float64).reshape(-1, 2)


def shown(name: str) -> str:
    """A name as a legend takes it: matplotlib leaves out labels that begin with an underscore."""
    return f"\u200b{name}" if name.startswith("_") else name


def to_svg(drawn: Figure, key: str, description: str) -> str:
    """An ``<svg>`` element to put into a page: as wide as its column, ids of its own, the page's text colour, no date.

    It says how narrow it may become (`LEAST_PX`).

    Args:
        drawn: the figure.
        key: unique in the page; prefixes every id.
        description: plain text, read out in place of the picture.

    """
    with matplotlib.rc_context(_STYLE):
        stream = io.StringIO()
        drawn.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"\s*<defs>\s*<style[^>]*>.*?</style>\s*</defs>", "", text, count=1, flags=re.DOTALL)
    # matplotlib defines a marker once for each series that uses it, and a legend's sample takes the series' id: the
    # first of each name is kept.
    seen: set[str] = set()
    text = re.sub(r'\sid="([^"]*)"', lambda found: _first(found.group(1), key, seen), text)
    text = re.sub(r"url\(#", f"url(#{key}-", text)
    text = re.sub(r'xlink:href="#', f'href="#{key}-', text)
    text = re.sub(r"xlink:href=", "href=", text)
    text = re.sub(r'(?<= d=")[^"]*|(?<= x=")[^"]*|(?<= y=")[^"]*', _rounded, text)
    text = re.sub(re.escape(INK), "currentColor", text, flags=re.IGNORECASE)
    view = re.search(r'viewBox="\S+ \S+ (\S+) \S+"', text)
    assert view is not None
    sizes = [float(size) for size in re.findall(r"font(?:-size)?: [^;\"]*?([\d.]+)px", text)]
    least = math.ceil(float(view.group(1)) * LEAST_PX / min(sizes)) if sizes else 0
    opening = (
        f'<svg class="drawing" {view.group(0)} style="min-width:{least}px" role="img" '
        f'aria-label="{_attribute(description)}">'
    )
    return opening + text[text.index(">") + 1 :].rstrip()


def to_png(drawn: Figure, dots_per_inch: int = 100) -> bytes:
    """A PNG on white with a palette of 256 colours: a fraction of the size, and nobody sees it."""
    with matplotlib.rc_context(_STYLE):
        stream = io.BytesIO()
        drawn.patch.set_alpha(1.0)
        drawn.savefig(stream, format="png", dpi=dots_per_inch, facecolor="white", metadata={"Software": None})
    small = io.BytesIO()
    with Image.open(stream) as image:
        image.convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            small, format="png", optimize=True
        )
    return small.getvalue()


def _first(name: str, key: str, seen: set[str]) -> str:
    if name in seen:
        return ""
    seen.add(name)
    return f' id="{key}-{name}"'


def _rounded(numbers: re.Match[str]) -> str:
    """Coordinates to a hundredth of a point: a fourth of the page's size is digits that nobody can see."""
    return " ".join(re.sub(r"-?\d+\.\d{3,}", lambda n: f"{float(n.group()):.2f}", numbers.group()).split())


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
