"""A replay over time: statuses, how sure, which classes; and success by distance travelled. Plain arrays in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from semloc_core.metrics import Row
from semloc_core.replay import FROM_METRES
from semloc_core.report.colours import BLUE, GREY, INK, ORANGE, OTHER, OTHER_STYLE, ClassLooks, styles
from semloc_core.report.drawing import bare, figure, shown

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STATUSES = ("match", "ambiguous", "unknown", "no_graph")
Run = tuple[str, float, float]
"""A stretch of equal statuses: which, from and to, seconds."""


def status_figure(runs: Sequence[Run], right: Sequence[tuple[float, float]] | None = None) -> Figure:
    """A lane for each status, filled while it held: which is told by the lane, not by the colour.

    Args:
        runs: stretches of equal status.
        right: stretches, from and to in seconds, in which the top match was right; None where nobody knows.

    """
    look = styles(STATUSES)
    lanes = {name: [(a, b) for status, a, b in runs if status == name] for name in STATUSES}
    colours = [look[name].colour for name in STATUSES]
    if right is not None:
        lanes["(truly right)"] = list(right)
        colours.append(GREY)
    with figure(0.9 + 0.33 * len(lanes)) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        for lane, (name, stretches) in enumerate(lanes.items()):
            bars = [(start, max(end - start, 1e-9)) for start, end in stretches]
            if bars:
                axes.broken_barh(bars, (lane - 0.38, 0.76), color=colours[lane], gid=f"lane-{name.strip('()')}")
        axes.set_yticks(range(len(lanes)), list(lanes))
        axes.set_ylim(len(lanes) - 0.4, -0.6)
        axes.set_xlabel("time (s)")
    return drawn


def confidence_figure(seconds: ArrayLike, similarity: ArrayLike, probability: ArrayLike) -> Figure:
    """Similarity and probability of the top match over time.

    Args:
        seconds: (T,).
        similarity: (T,) cosine; NaN where there was no match.
        probability: (T,) in [0, 1]; NaN where there was no match.

    """
    with figure(2.9) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        axes.plot(seconds, similarity, color=BLUE, linewidth=1.4, label="cosine similarity", gid="similarity")
        axes.plot(seconds, probability, color=ORANGE, linewidth=1.4, ls="--", label="probability", gid="probability")
        axes.set_ylim(min(-0.02, _least(similarity) - 0.05), 1.03)
        axes.set_xlabel("time (s)")
        drawn.legend(loc="outside upper center", ncols=2)
    return drawn


def shares_figure(seconds: Sequence[float], shares: Mapping[str, Sequence[float]], classes: ClassLooks) -> Figure:
    """Shares of classes, stacked, over time.

    Args:
        seconds: (T,) rising.
        shares: class, or `OTHER`, -> (T,) its share; stacked in this order from below.
        classes: how they look.

    """
    times, index = _held(np.asarray(seconds, dtype=np.float64))
    with figure(3.5) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        below = np.zeros(len(times))
        for i, (name, values) in enumerate(shares.items()):
            above = below + np.append(values, 0.0)[index]
            look = OTHER_STYLE if name == OTHER else classes[name]
            axes.fill_between(
                times, below, above, step="post", facecolor=look.colour, edgecolor=INK, hatch=look.hatch,
                linewidth=0.3, alpha=0.85, label=shown(name), gid=f"share-{i}",
            )  # fmt: skip
            below = above
        axes.set_ylim(0, 1)
        axes.set_ylabel("share")
        axes.set_xlabel("time (s)")
        drawn.legend(loc="outside lower center", ncols=3, columnspacing=1.0, handlelength=1.6)
    return drawn


def success_figure(rows: Sequence[Row]) -> Figure:
    """Bars of success@1, @5 and @10 by distance travelled (rows as of `TraversalScore.rows`)."""
    names = [name for name in ("success@1", "success@5", "success@10") if name in rows[0]]
    look = styles(names)
    with figure(2.9) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        width = 0.8 / len(names)
        for i, name in enumerate(names):
            at = np.arange(len(rows)) + (i - (len(names) - 1) / 2) * width
            values = [float(row[name] or 0.0) for row in rows]
            axes.bar(
                at, values, width * 0.92, color=look[name].colour, hatch=look[name].hatch, edgecolor=INK,
                linewidth=0.5, label=name, gid=f"bars-{i}",
            )  # fmt: skip
        axes.set_xticks(range(len(rows)), [bracket(str(row["scope"])) for row in rows])
        axes.set_xlabel("distance travelled")
        axes.set_ylim(0, 1.03)
        drawn.legend(loc="outside upper center", ncols=3)
    return drawn


def latency_figure(seconds: ArrayLike, milliseconds: ArrayLike) -> Figure:
    """Latency of each answer over time, on a logarithmic axis."""
    with figure(2.5) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        axes.plot(seconds, milliseconds, ".", ms=4, color=BLUE, gid="latency")
        axes.set_yscale("log")
        axes.set_xlabel("time (s)")
        axes.set_ylabel("latency (ms)")
    return drawn


def bracket(scope: str) -> str:
    """A row's scope as a person reads it: ``5m`` is ``5–10 m``."""
    if scope == "all":
        return "all"
    start = float(scope.removesuffix("m"))
    end = next((value for value in FROM_METRES if value > start), None)
    return f"{start:g}+ m" if end is None else f"{start:g}–{end:g} m"


def _least(values: ArrayLike) -> float:
    known = np.asarray(values, dtype=np.float64)
    known = known[~np.isnan(known)]
    return float(known.min()) if len(known) else 0.0


def _held(seconds: Floats) -> tuple[Floats, Ints]:
    """Times at which the drawn shares change, and which row holds from each: none (-1) over a long silence."""
    usual = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    times: list[float] = []
    index: list[int] = []
    for row, start in enumerate(seconds.tolist()):
        times.append(start)
        index.append(row)
        following = seconds[row + 1] if row + 1 < len(seconds) else np.inf
        if following - start > 5 * usual:
            times.append(start + usual)
            index.append(-1)
    return np.array(times, dtype=np.float64), np.array(index, dtype=np.int64)
