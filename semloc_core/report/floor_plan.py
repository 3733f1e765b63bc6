"""Floor plans: a building's places and objects from above, and what is drawn onto them. Plain arrays in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from semloc_core.graph import SceneGraph
from semloc_core.report.colours import INK, OTHER, OTHER_STYLE, RIGHT, SCALE, WRONG, ClassLooks
from semloc_core.report.drawing import WIDTH, bare, figure, legend_below, points, shown
from semloc_core.text import short_repr

Floats = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class Plan:
    """What a floor plan shows of a building.

    Args:
        name: the building's name.
        places: (P, 2) metres.
        edges: (E, 2, 2) both ends of each traversability edge, metres.
        objects: class name -> (n, 2) metres.

    """

    name: str
    places: Floats
    edges: Floats
    objects: dict[str, Floats]

    @classmethod
    def of(cls, graph: SceneGraph, name: str) -> Plan:
        """From a scene graph, in canonical order."""
        at = graph.places
        edges = [(at[a][:2], at[b][:2]) for a in sorted(at) for b in sorted(graph.neighbours[a]) if a < b]
        objects: dict[str, list[tuple[float, float]]] = {}
        for id_ in sorted(graph.objects):
            item = graph.objects[id_]
            objects.setdefault(item.class_, []).append(item.position[:2])
        return cls(
            name,
            points([at[p][:2] for p in sorted(at)]),
            np.array(edges, dtype=np.float64).reshape(-1, 2, 2),
            {c: points(objects[c]) for c in sorted(objects, key=lambda c: (-len(objects[c]), c))},
        )

    def limits(self) -> tuple[Floats, Floats]:
        """Lower left and upper right corner of what is drawn, with a margin."""
        everything = np.concatenate([self.places, *self.objects.values()])
        if not len(everything):
            return np.zeros(2), np.ones(2)
        low, high = everything.min(axis=0), everything.max(axis=0)
        margin = 0.03 * float((high - low).max()) + 0.3
        # A corridor is not drawn as a line: nothing is more than three times as long as it is wide.
        room = np.maximum((high - low).max() / 3.0 - (high - low), 0.0) / 2.0 + margin
        return low - room, high + room

    def height(self, extra: float, *, beside: float = 0.0) -> float:
        """Inches that a figure of this plan takes, with ``extra`` for legends, and ``beside`` for a colour bar."""
        low, high = self.limits()
        across, up = high - low
        return float(min((WIDTH - 0.75 - beside) * up / across, WIDTH * 1.5)) + 0.75 + extra


def legend_height(entries: int) -> float:
    """Inches that a legend of so many entries takes under a plan, three in a row."""
    return 0.3 + 0.24 * math.ceil(entries / 3)


def draw_building(axes: Axes, plan: Plan, *, objects: bool = False) -> None:
    """Edges and places in faint ink; objects, if wanted, as small grey squares."""
    bare(axes)
    # One line with gaps is one element of the picture; a collection would be one for each edge.
    gap = np.full((len(plan.edges), 1, 2), np.nan)
    ways = np.concatenate([plan.edges, gap], axis=1).reshape(-1, 2)
    axes.plot(*ways.T, color=INK, alpha=0.22, linewidth=0.7, gid="edges")
    axes.plot(*plan.places.T, ".", ms=2.6, mew=0, color=INK, alpha=0.4, gid="places")
    if objects and plan.objects:
        at = np.concatenate(list(plan.objects.values()))
        axes.plot(*at.T, "s", ms=3.4, mew=0, color=INK, alpha=0.3, gid="objects")
    low, high = plan.limits()
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box")
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(plan.name, loc="left")


def building_figure(plan: Plan, classes: ClassLooks) -> Figure:
    """A building as the map has it: places, the ways between them, objects by class.

    Args:
        plan: the building.
        classes: all classes that the report shows, and how they look.

    """
    own, rest = classes.own, classes.rest
    with figure(plan.height(legend_height(min(len(plan.objects), len(own) + 1)))) as drawn:
        axes = drawn.add_subplot()
        draw_building(axes, plan)
        for name in [c for c in own if c in plan.objects]:
            style = classes[name]
            x, y = plan.objects[name].T
            axes.scatter(
                x, y, s=38, marker=style.marker, color=style.colour, edgecolors=INK, linewidths=0.5, zorder=3,
                label=shown(f"{name} ({len(x)})"), gid=f"class-{own.index(name)}",
            )  # fmt: skip
        left = [plan.objects[c] for c in rest if c in plan.objects]
        if left:
            x, y = np.concatenate(left).T
            label = f"{OTHER} ({len(x)})"
            axes.scatter(x, y, s=14, zorder=2, color=OTHER_STYLE.colour, gid="class-other", label=label)
        legend_below(drawn, axes, 0.2)
    return drawn


def path_figure(
    plan: Plan, path: ArrayLike, path_right: ArrayLike, right: ArrayLike, wrong: ArrayLike, unjudged: ArrayLike,
    probability: ArrayLike,
) -> Figure:  # fmt: skip
    """Where the robot was, and where the answers put it. A place that many answers name is drawn larger.

    Args:
        plan: the building.
        path: (T, 2) true positions in order, metres; empty where they are not known. A row of NaN interrupts it.
        path_right: (T,) whether the answer given there was right.
        right, wrong: (n, 2) top matches that were within the match radius of the truth, and that were not.
        unjudged: (n, 2) top matches without a truth to compare them with.
        probability: (n,) of the unjudged ones; colours them.

    """
    path, unjudged = points(path), points(unjudged)
    with figure(plan.height(legend_height(6), beside=0.9 if len(unjudged) else 0.0)) as drawn:
        axes = drawn.add_subplot()
        draw_building(axes, plan, objects=True)
        if len(path):
            _draw_path(axes, path, np.asarray(path_right, dtype=np.bool_))
        _judged(axes, points(right), RIGHT, "o", "put here rightly", "right")
        _judged(axes, points(wrong), WRONG, "X", "put here wrongly", "wrong")
        if len(unjudged):
            x, y = unjudged.T
            marks = axes.scatter(
                x, y, c=np.asarray(probability), cmap=SCALE, vmin=0, vmax=1, s=26, zorder=4,
                edgecolors=INK, linewidths=0.4, label=f"put here ({len(unjudged)})", gid="unjudged",
            )  # fmt: skip
            drawn.colorbar(marks, ax=axes, label="probability", shrink=0.7)
        legend_below(drawn, axes, 0.4)
    return drawn


def _draw_path(axes: Axes, path: Floats, right: NDArray[np.bool_]) -> None:
    axes.plot(*path.T, color=INK, linewidth=1.6, solid_capstyle="round", label="true path", gid="path")
    good = [path[i : i + 2] for i in np.flatnonzero(right[:-1]) if not np.isnan(path[i : i + 2]).any()]
    if good:
        look = {"colors": RIGHT, "linewidths": 4.0, "capstyle": "round", "label": "true path, answered rightly"}
        axes.add_collection(LineCollection(good, zorder=2.5, gid="path-right", **look))
    known = path[~np.isnan(path[:, 0])]
    for name, marker, at in (("start", "o", known[0]), ("end", "s", known[-1])):
        axes.plot(*at, marker, ls="", color="white", mec=INK, mew=1.6, ms=8, label=name, zorder=5, gid=name)


def _judged(axes: Axes, at: Floats, colour: str, marker: str, label: str, gid: str) -> None:
    if not len(at):
        return
    places, counts = np.unique(at, axis=0, return_counts=True)
    x, y = places.T
    axes.scatter(
        x, y, s=22.0 + 110.0 * counts / counts.max(), color=colour, marker=marker, edgecolors=INK, linewidths=0.5,
        zorder=4, alpha=0.85, label=f"{label} ({len(at)})", gid=gid,
    )  # fmt: skip


def confusion_figure(plan: Plan, places: ArrayLike, counts: Sequence[int], numbers: Sequence[int]) -> Figure:
    """Where wrong answers fell: a numbered disc a place, its area as large as it was often taken.

    Args:
        plan: the building.
        places: (n, 2) metres, the most frequent first.
        counts: (n,) how often.
        numbers: (n,) what to write on each.

    """
    places = points(places)
    with figure(plan.height(0.15)) as drawn:
        axes = drawn.add_subplot()
        draw_building(axes, plan, objects=True)
        if len(places):
            area = 500.0 * np.asarray(counts) / max(counts)
            x, y = places.T
            axes.scatter(x, y, s=area, color=WRONG, alpha=0.45, edgecolors=INK, linewidths=0.8, gid="confusions")
        for number, (x, y) in reversed(list(zip(numbers, places.tolist(), strict=True))):
            axes.annotate(str(number), (x, y), ha="center", va="center", fontweight="bold")
    return drawn


def similarity_figure(
    plan: Plan, similarity: ArrayLike, query: ArrayLike | None = None, *, objects: bool = True
) -> Figure:
    """Places coloured by their cosine similarity to a query (the paper's Figure 1), from the least to the largest.

    Args:
        plan: the building.
        similarity: (P,) cosine similarities, in the order of the plan's places.
        query: (2,) where the query truly is, metres; None: not known, or in another building.
        objects: whether objects are drawn, as crosses.

    """
    values = np.asarray(similarity, dtype=np.float64)
    assert values.shape == (len(plan.places),), values.shape
    with figure(plan.height(legend_height(2), beside=0.9)) as drawn:
        axes = drawn.add_subplot()
        draw_building(axes, plan)
        order = np.argsort(values, kind="stable")
        x, y = plan.places[order].T
        marks = axes.scatter(
            x, y, c=values[order], cmap=SCALE, s=22, edgecolors=INK, linewidths=0.2, zorder=3, gid="similarity",
        )  # fmt: skip
        handles: list[Line2D] = []
        if objects and plan.objects:
            at = np.concatenate(list(plan.objects.values()))
            axes.plot(*at.T, "+", ms=4.5, mew=0.9, color=INK, gid="objects")
            handles.append(Line2D([], [], ls="", marker="+", color=INK, label="object"))
        if query is not None:
            axes.plot(*np.asarray(query, dtype=np.float64), "*", ms=17, color=WRONG, mec=INK, zorder=5, gid="query")
            handles.append(Line2D([], [], ls="", marker="*", ms=12, color=WRONG, mec=INK, label="the query"))
        drawn.colorbar(marks, ax=axes, label="cosine similarity", shrink=0.7)
        if handles:
            drawn.legend(handles=handles, loc="outside lower center", ncols=2)
    return drawn
