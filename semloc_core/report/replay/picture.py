"""One picture of one answer: where the robot was, where it was put, and which classes say so."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semloc_core.errors import BagError
from semloc_core.map_database import LoadedMap
from semloc_core.report.colours import INK, OTHER, OTHER_STYLE, RIGHT, WRONG, ClassLooks
from semloc_core.report.drawing import figure, shown, to_png
from semloc_core.report.floor_plan import Floats, Plan, draw_building
from semloc_core.report.replay.frames import Frame, Share
from semloc_core.report.replay.gathering import ReplayData
from semloc_core.text import percent

_WIDTH, _LEAST_HEIGHT, _BARS = 9.0, 3.2, 6


def answer_picture(data: ReplayData, loaded: LoadedMap) -> bytes:
    """The clearest answer of a replay as PNG: a right one if there is any, then the most probable.

    Args:
        data: of the replay.
        loaded: the map that answered.

    Raises:
        BagError: no answer brings attributions.

    """
    best = data.best
    if best is None:
        raise BagError("expected an answer with attributions (got none in the results)")
    name = best.candidates[0].map
    plan = Plan.of(loaded.graph(name), name)
    shares = best.because or best.attention
    order = [of for of, _ in shares]
    classes = ClassLooks(loaded.model.labelspace.classes, [*order, *(of for of in plan.objects if of not in order)])
    earlier = [of.truth.position[:2] for of in data.frames if of.truth and of.truth.map == name and of.t <= best.t]
    path = np.array(earlier, dtype=np.float64).reshape(-1, 2)
    return to_png(_draw(plan, path, best, shares, classes), 130)


def _draw(plan: Plan, path: Floats, best: Frame, shares: Sequence[Share], classes: ClassLooks) -> Figure:
    match, truth = best.candidates[0], best.truth
    low, high = plan.limits()
    height = float(np.clip(0.62 * _WIDTH * (high - low)[1] / (high - low)[0] + 1.2, _LEAST_HEIGHT, 6.8))
    own = classes.own
    with figure(height, _WIDTH) as drawn:
        left, right = drawn.subplots(1, 2, width_ratios=[2.3, 1])
        draw_building(left, plan)
        left.set_title(f"{plan.name}, seen from above", loc="left")
        left.set_axis_off()
        if len(path):
            left.plot(*path.T, color=INK, linewidth=2.2, solid_capstyle="round", label="the robot's path", zorder=4)
        if truth is not None and truth.map == plan.name:
            x, y, _ = truth.position
            left.plot(x, y, "o", ms=9, color="white", mec=INK, mew=2.2, ls="", label="the robot", zorder=6)
        x, y, _ = match.position
        colour = WRONG if best.right is False else RIGHT
        off = math.dist(match.position, truth.position) if truth is not None and truth.map == match.map else None
        label = "the answer" if off is None else f"the answer, {off:.1f} m off"
        left.plot(x, y, "*", ms=21, color=colour, mec=INK, mew=0.9, ls="", label=label, zorder=5)
        for name in [c for c in own if c in plan.objects]:
            x, y = plan.objects[name].T
            style = classes[name]
            left.scatter(
                x, y, s=30, marker=style.marker, color=style.colour, edgecolors=INK, linewidths=0.4, zorder=3,
                label=shown(name),
            )  # fmt: skip
        left_over = [plan.objects[c] for c in plan.objects if c not in own]
        if left_over:
            x, y = np.concatenate(left_over).T
            left.scatter(x, y, s=12, color=OTHER_STYLE.colour, zorder=2, label=OTHER)
        drawn.legend(loc="outside lower left", ncols=5, handletextpad=0.4, columnspacing=1.2)
        _bars(right, shares, classes)
    return drawn


def _bars(axes: Axes, of_classes: Sequence[Share], classes: ClassLooks) -> None:
    """The largest shares as bars, named by class."""
    shares = sorted(((name, share) for name, share in of_classes if share >= 0.005), key=lambda of: (-of[1], of[0]))
    shares = shares[:_BARS]
    for row, (name, share) in enumerate(shares):
        style = classes[name]
        axes.barh(row, share, 0.62, color=style.colour, hatch=style.hatch, edgecolor=INK, linewidth=0.5)
        axes.annotate(percent(share), (share, row), (4, 0), textcoords="offset points", va="center")
    axes.set_yticks(range(len(shares)), [name for name, _ in shares])
    axes.set_ylim(max(len(shares), 4) - 0.4, -0.6)
    axes.set_xlim(0, 1.18 * max((share for _, share in shares), default=1.0))
    axes.xaxis.set_visible(False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.patch.set_alpha(0.0)
    axes.set_title("what the answer rests on", loc="left")
