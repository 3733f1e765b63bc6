"""The paper's figures on retrieval and explanations, from plain arrays and rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from semloc_core.graph import Floats
from semloc_core.report.colours import INK, SCALE, ClassLooks, styles
from semloc_core.report.drawing import TEXT, bare, figure, folded, shown
from semloc_core.text import short_repr

CONTROL_LINES: tuple[tuple[int, tuple[float, ...]], ...] = ((0, (1, 1.5)), (0, (4, 2.5)), (0, (6, 2, 1, 2)))


def matrix_figure(title: str, matrix: ArrayLike) -> Figure:
    """A place–query matrix (of the paper's truth, bag of words or model).

    Its scale goes from its least to its largest value, as the bar says: encoders spread their similarities
    differently, and what is compared is the pattern.

    Args:
        title: whose it is.
        matrix: (Q, P), a query a row; similarities, or 1 where the place is right and 0 elsewhere. Let neighbours in
            the building be neighbours in the order, so that a diagonal is seen.

    """
    values = np.asarray(matrix, dtype=np.float64)
    assert values.ndim == 2, values.shape
    with figure(3.6) as drawn:
        axes = drawn.add_subplot()
        image = axes.imshow(values, cmap=SCALE, aspect="auto", gid="matrix")
        axes.set_title(title, loc="left")
        axes.set_xlabel("place")
        axes.set_ylabel("query")
        drawn.colorbar(image, ax=axes)
    return drawn


def importance_figure(classes: Sequence[str], importance: Mapping[str, ArrayLike], looks: ClassLooks) -> Figure:
    """Mean importance of every object, one panel an explainer; objects in the same order in all of them.

    Args:
        classes: (O,) class of each object.
        importance: explainer -> (O,) mean score over all places; each panel is scaled by its own largest.
        looks: the classes and how they look.

    """
    scores = {name: np.asarray(values, dtype=np.float64) for name, values in importance.items()}
    for values in scores.values():
        assert values.shape == (len(classes),), values.shape
    scaled = {name: values / max(float(np.abs(values).max(initial=0.0)), 1e-300) for name, values in scores.items()}
    rank = np.argsort(-np.mean(list(scaled.values()), axis=0), kind="stable")
    legend = 0.25 * math.ceil(len(set(classes)) / 2)
    with figure(1.0 + 1.15 * len(scores) + legend) as drawn:
        column = drawn.subplots(len(scores), 1, sharex=True, squeeze=False)[:, 0]
        handles = {}
        for number, (axes, (name, values)) in enumerate(zip(column, scaled.items(), strict=True)):
            bare(axes)
            axes.vlines(np.arange(len(rank)), 0.0, values[rank], color=INK, alpha=0.25, linewidth=0.7)
            for class_ in looks.order:
                own = np.flatnonzero(np.array([classes[i] == class_ for i in rank], dtype=np.bool_))
                if not len(own):
                    continue
                style = looks[class_]
                handles[shown(class_)] = axes.scatter(
                    own, values[rank[own]], s=17, marker=style.marker, color=style.colour, edgecolors=INK,
                    linewidths=0.3, zorder=3, gid=f"objects-{number}-{looks.order.index(class_)}",
                )  # fmt: skip
            axes.set_title(name.replace("_", " "), loc="left")
            axes.set_ylim(min(-0.05, float(values.min(initial=0.0)) - 0.05), 1.1)
        column[-1].set_xlabel(folded("objects, by mean importance over all explainers"))
        drawn.supylabel("importance (largest = 1)", fontsize=TEXT)
        drawn.legend(
            list(handles.values()), list(handles), loc="outside lower center", ncols=2, handletextpad=0.2,
            columnspacing=1.0,
        )  # fmt: skip
    return drawn


@short_repr
@dataclass(frozen=True, eq=False)
class FidelityCurves:
    """Of one explainer: (B,) each, one value a budget. ``control``: not an explainer, drawn faintly."""

    necessity: Floats
    sufficiency: Floats
    characterisation: Floats
    control: bool = False


def fidelity_figure(budgets: ArrayLike, curves: Mapping[str, FidelityCurves]) -> Figure:
    """Necessity Δ⁺, sufficiency Δ⁻ and characterisation score over the budget ρ, one above the other.

    Args:
        budgets: (B,) fractions of objects, rising.
        curves: explainer -> its curves.

    """
    rho = np.asarray(budgets, dtype=np.float64)
    look = styles([name for name, curve in curves.items() if not curve.control])
    controls = [name for name, curve in curves.items() if curve.control]
    faint = {name: CONTROL_LINES[i % len(CONTROL_LINES)] for i, name in enumerate(controls)}
    panels = (
        ("necessity", "Δ⁺ (higher is better)"),
        ("sufficiency", "Δ⁻ (lower is better)"),
        ("characterisation", "score (higher is better)"),
    )
    with figure(6.4) as drawn:
        column = drawn.subplots(3, 1, sharex=True)
        handles = {}
        for axes, (attribute, label) in zip(column, panels, strict=True):
            bare(axes)
            for number, (name, curve) in enumerate(curves.items()):
                values = np.asarray(getattr(curve, attribute), dtype=np.float64)
                assert values.shape == rho.shape, (name, attribute, values.shape)
                gid = f"{attribute}-{number}"
                if curve.control:
                    line = axes.plot(rho, values, color=INK, alpha=0.55, ls=faint[name], lw=1.3, gid=gid)[0]
                else:
                    style = look[name]
                    line = axes.plot(
                        rho, values, color=style.colour, ls=style.line, marker=style.marker, ms=5, lw=1.6, mec=INK,
                        mew=0.3, gid=gid,
                    )[0]  # fmt: skip
                handles[shown(name.replace("_", " ") + (" (control)" if curve.control else ""))] = line
            axes.set_title(f"{attribute}: {label}", loc="left")
        column[-1].set_xlabel(folded("budget ρ: fraction of objects removed (Δ⁺) or kept (Δ⁻)"))
        drawn.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=1)
    return drawn


def randomisation_figure(layers: Sequence[str], correlation: Mapping[str, Sequence[float]]) -> Figure:
    """How much of an explanation is left when the model's layers are shuffled, one more at each step.

    Args:
        layers: from the output down.
        correlation: explainer -> one figure a layer.

    """
    look = styles(list(correlation))
    with figure(4.2) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        axes.axhline(0.0, color=INK, alpha=0.4, linewidth=0.8)
        for number, (name, values) in enumerate(correlation.items()):
            style = look[name]
            axes.plot(
                range(len(layers) + 1), [1.0, *values], color=style.colour, ls=style.line, marker=style.marker, ms=5,
                lw=1.6, mec=INK, mew=0.3, gid=f"shuffled-{number}", label=shown(name.replace("_", " ")),
            )  # fmt: skip
        axes.set_xticks(
            range(len(layers) + 1),
            ["none", *(f"+ {layer}" for layer in layers)],
            rotation=35,
            ha="right",
            rotation_mode="anchor",
        )
        axes.set_xlabel("layers shuffled")
        axes.set_ylabel("rank correlation")
        axes.set_ylim(min(-0.25, axes.get_ylim()[0]), 1.05)
        drawn.legend(loc="outside lower center", ncols=1)
    return drawn


def shift_figure(classes: ClassLooks, shift: ArrayLike, drop: ArrayLike, correlation: str = "") -> Figure:
    """Change in PR-AUC when a class is removed, against the shift of attention when it is perturbed.

    Args:
        classes: the C classes, in ``classes.order``, and how they look.
        shift: (C,) or (C, R) Jensen–Shannon divergence normalised by frequency, a column a run.
        drop: of the same shape, change in PR-AUC normalised by frequency.
        correlation: words to put into the figure, e.g. ``ρ = 0.83 [0.4, 0.95]``.

    """
    x, y = (np.asarray(values, dtype=np.float64).reshape(len(classes.order), -1) for values in (shift, drop))
    assert x.shape == y.shape, (x.shape, y.shape)
    own = classes.own
    with figure(4.0) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        named: list[tuple[float, float]] = []
        across, up = (max(float(np.ptp(values)), 1e-12) for values in (x, y))
        for number, name in enumerate(classes.order):
            style = classes[name]
            axes.scatter(
                x[number], y[number], s=52, marker=style.marker, color=style.colour, edgecolors=INK, linewidths=0.5,
                zorder=3, gid=f"class-{number}", label=shown(name),
            )  # fmt: skip
            # The name stands at the highest mark: a legend would make the reader match shapes.
            top = int(np.argmax(y[number]))
            at = (float(x[number, top]), float(y[number, top]))
            free = all(abs(at[0] - a) > 0.3 * across or abs(at[1] - b) > 0.09 * up for a, b in named)
            if name in own and free:  # names would be written over each other; the table has all
                named.append(at)
                axes.annotate(name, at, (0, 7), textcoords="offset points", ha="center")
        axes.margins(0.14)
        axes.axhline(0.0, color=INK, alpha=0.4, linewidth=0.8)
        axes.set_xlabel("shift of attention (JSD / frequency)")
        axes.set_ylabel("change in PR-AUC / frequency")
        if correlation:
            axes.set_title(folded(correlation), loc="left")
    return drawn
