"""Pictures of when to trust an answer: how honest it is, how soon it is right, and one that is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from semloc_core.report.colours import INK, OTHER, OTHER_STYLE, WRONG, ClassLooks, styles
from semloc_core.report.drawing import bare, figure, points, shown
from semloc_core.report.floor_plan import Plan, draw_building

MARGIN_M = 4.0
"""Shown around the objects of a failure, and the robot."""


def reliability_figure(curves: Mapping[str, Sequence[tuple[float, float, float, float, float]]]) -> Figure:
    """What was said against what was so.

    Args:
        curves: name -> points (said, so, its interval's low and high end, share of all answers); discs are as large as
            the share.

    """
    look = styles(list(curves))
    with figure(4.6) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        axes.plot([0, 1], [0, 1], color=INK, alpha=0.5, linewidth=1, label="honest")
        for name, points in curves.items():
            said, so, low, high, share = np.array(points, dtype=np.float64).reshape(-1, 5).T
            style = look[name]
            axes.errorbar(
                said, so, np.maximum([so - low, high - so], 0.0), color=style.colour, ls="", linewidth=1, alpha=0.7
            )
            axes.scatter(
                said, so, s=16 + 300 * share, marker=style.marker, color=style.colour, edgecolors=INK, linewidths=0.5,
                zorder=3, label=shown(name),
            )  # fmt: skip
        axes.set_xlabel("probability that was said")
        axes.set_ylabel("share of right answers")
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(-0.03, 1.05)
        axes.legend(loc="upper left")
    return drawn


def success_figure(metres: Sequence[float], curves: Mapping[str, Sequence[tuple[float, float, float]]]) -> Figure:
    """Success by metres walked.

    Args:
        metres: (K,) walked.
        curves: name -> K points (mean, low and high end of its interval).

    """
    look = styles(list(curves))
    with figure(4.2) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        for name, points in curves.items():
            mean, low, high = np.array(points).T
            style = look[name]
            axes.fill_between(metres, low, high, color=style.colour, alpha=0.15, linewidth=0)
            axes.plot(metres, mean, ls=style.line, marker=style.marker, color=style.colour, label=shown(name))
        axes.set_xlabel("metres walked since the graph was begun")
        axes.set_ylabel("share of answers")
        axes.set_ylim(-0.02, 1.04)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return drawn


def failure_figure(
    here: Plan,
    there: Plan,
    path: ArrayLike,
    truth: ArrayLike,
    answer: ArrayLike,
    seen_here: Mapping[str, ArrayLike],
    seen_there: Mapping[str, ArrayLike],
    labelspace: Sequence[str],
) -> Figure:
    """A wrong answer: on the left where the robot is, on the right where it was put, and how what it saw fits there.

    Args:
        here, there: the buildings, as mapped.
        path: (T, 2) the way walked, metres.
        truth, answer: (2,) where the robot is, and where it was put.
        seen_here, seen_there: class -> (n, 2) seen objects, laid on either building.
        labelspace: its classes, which give the looks.

    """
    names = sorted(seen_here, key=lambda name: (-len(np.asarray(seen_here[name])), name))
    looks = ClassLooks(labelspace, names)
    with figure(5.4, 9.6) as drawn:
        left, right = drawn.subplots(1, 2)
        _laid(left, here, seen_here, looks, f"where the robot is: {here.name}", truth)
        left.plot(*np.asarray(path, dtype=np.float64).T, color=INK, linewidth=2.0, label="the robot's path", zorder=2.5)
        left.plot(*np.asarray(truth), "o", ms=9, color="white", mec=INK, mew=2.2, ls="", label="the robot", zorder=6)
        _laid(right, there, seen_there, looks, f"where it was put: {there.name}", answer)
        right.plot(*np.asarray(answer), "*", ms=19, color=WRONG, mec=INK, ls="", label="the answer", zorder=6)
        found = dict(
            item for axes in (left, right) for item in zip(*reversed(axes.get_legend_handles_labels()), strict=True)
        )
        drawn.legend(list(found.values()), list(found), loc="outside lower center", ncols=5, columnspacing=1.0)
    return drawn


def _laid(
    axes: Axes, plan: Plan, seen: Mapping[str, ArrayLike], looks: ClassLooks, title: str, robot: ArrayLike
) -> None:
    draw_building(axes, plan)
    axes.set_title(title, loc="left")
    for name in looks.own:
        style = looks[name]
        mapped = plan.objects.get(name, np.zeros((0, 2)))
        x, y = mapped.T
        axes.scatter(
            x, y, s=110, marker=style.marker, facecolors="none", edgecolors=style.colour, linewidths=1.4, zorder=3
        )
        x, y = points(seen[name]).T
        axes.scatter(
            x, y, s=34, marker=style.marker, color=style.colour, edgecolors=INK, linewidths=0.5,
            zorder=4, label=shown(name),
        )  # fmt: skip
    if looks.rest:
        others = np.concatenate([points(seen[name]) for name in looks.rest])
        x, y = others.T
        axes.scatter(x, y, s=16, color=OTHER_STYLE.colour, zorder=3, label=OTHER)
    every = np.concatenate([points(robot), *(points(each) for each in seen.values())])
    low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.scatter([], [], s=110, facecolors="none", edgecolors=INK, label="on the map (rings)")
    axes.scatter([], [], s=34, color=INK, label="seen (filled)")
