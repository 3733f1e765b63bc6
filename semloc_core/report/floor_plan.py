"""Floor plans: a building's places and objects from above, and what is drawn onto them. Plain arrays in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from semloc_core.graph import SceneGraph
from semloc_core.report.colours import INK, SCALE, WRONG
from semloc_core.report.drawing import WIDTH, bare, figure, points
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
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(plan.name, loc="left")


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
