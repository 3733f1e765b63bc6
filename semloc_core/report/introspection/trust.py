"""The sections of a study's page that ask whether the explanations can be believed."""

from __future__ import annotations

import numpy as np

from semloc_core.explain import BUDGET, CONTROLS
from semloc_core.introspection import ABLATION, ALL_EXPLAINERS, INVERTED, Introspection, correlation, mean_rows
from semloc_core.metrics import Row
from semloc_core.report.drawing import to_svg
from semloc_core.report.introspection.figures import FidelityCurves, fidelity_figure, randomisation_figure
from semloc_core.report.introspection.sections import plain, readable
from semloc_core.report.page import Section, Table

LAYERS = {"project": "input", "layers": "messages", "gat": "attention", "embed": "output", "score": "attention"}
"""Parts of the encoders for readers."""
PARTS = ("necessity", "sufficiency", "characterisation")


def fidelity(found: Introspection) -> Section:
    """The three fidelity curves, means over the runs, with the controls."""
    curves = [run.introspection.fidelity for run in found.runs]
    budgets = next(iter(curves[0].values())).budgets
    at = int(np.argmin(np.abs(budgets - BUDGET)))
    controls = {*CONTROLS, INVERTED}
    values = {
        name: {part: np.array([getattr(of[name], part) for of in curves]) for part in PARTS} for name in curves[0]
    }
    score = {name: float(of["characterisation"][:, at].mean()) for name, of in values.items()}
    real = [name for name in values if name not in controls]
    best = max(real, key=lambda name: score[name]) if real else "random"
    against = [row for row in found.controls if row["scope"] == "against random"]
    beaten = [plain(str(row["method"])) for row in against if row["verdict"] != "better"]
    said = "every explainer beats the random one" if not beaten else f"no better than random: {', '.join(beaten)}"
    rows: list[Row] = [
        {
            "method": name,
            "budget": float(budget),
            **{
                key: value
                for part, of in values[name].items()
                for key, value in ((part, float(of[:, b].mean())), (f"{part}_std", float(of[:, b].std())))
            },
        }
        for name in values
        for b, budget in enumerate(budgets)
    ]
    upside_down = f", and {plain(found.methods[0])} upside down" if found.methods else ""
    return Section(
        "fidelity",
        "Can the explanations be trusted?",
        "Take away the objects that an explainer puts first and the similarity should fall (necessity, high is good); "
        "keep only them and it should stay (sufficiency, low is good); the score sums up both. At a budget of "
        f"{BUDGET:g} of the objects {plain(best)} is best with {score[best]:.3f}, random has {score['random']:.3f}; "
        f"{said}. Faint lines are controls: random{upside_down}.",
        to_svg(
            fidelity_figure(
                budgets,
                {
                    name: FidelityCurves(**{p: v.mean(0) for p, v in of.items()}, control=name in controls)
                    for name, of in values.items()
                },
            ),
            "fidelity",
            "necessity, sufficiency and characterisation score over the budget, a line an explainer",
        ),
        [
            Table(
                f"characterisation score less a control's, at a budget of {BUDGET:g}",
                readable([{k: v for k, v in row.items() if k != "budget"} for row in found.controls], scope="control"),
                "95 % bootstrap intervals over runs and squares of the building; the same places for both.",
            ),
            Table("means over the runs, ± their deviation", readable(rows)),
        ],
    )


def sanity(found: Introspection) -> Section | None:
    """The model-randomisation check, and Integrated Gradients' baselines."""
    if not found.sanity:
        return None
    rows = mean_rows(found.sanity)
    down = [row for row in rows if row["way"] == "cascading"]
    layers = list(dict.fromkeys(str(row["scope"]) for row in down))
    lines = {
        method: [
            next(_figure(row) for row in down if (row["method"], row["scope"]) == (method, layer)) for layer in layers
        ]
        for method in found.methods
    }
    deaf = [f"{plain(method)} {values[-1]:.2f}" for method, values in lines.items() if values[-1] > 0.5]
    verdict = (
        f"With every layer shuffled this much is left: {', '.join(deaf)}. That ranking comes from the graph and not "
        "from what the model has learnt."
        if deaf
        else "With every layer shuffled none keeps more than half of its ranking: all look at the model."
    )
    baseline = {str(row["scope"]): _figure(row) for row in rows if row["way"] == "baseline"}
    hangs = (
        " Integrated Gradients has a free choice, where to start from: its ranking from a uniform start agrees with "
        f"that from zero with ρ = {baseline['uniform']:.2f}, from the mean object with {baseline['mean']:.2f}."
        if baseline
        else ""
    )
    table: list[Row] = [
        {
            "explainer": plain(method),
            **{
                layer_name(layer): next(
                    (_figure(r) for r in rows if (r["method"], r["scope"], r["way"]) == (method, layer, way)), None
                )
                for layer in layers
            },
            "shuffled": "this and all above" if way == "cascading" else "this alone",
        }
        for way in ("cascading", "alone")
        for method in found.methods
    ]
    return Section(
        "sanity",
        "Do explanations change when the model does?",
        "The network's weights are shuffled, layer after layer from its output down; an explanation of the model must "
        f"become another one, and its line fall to zero. {verdict}{hangs}",
        to_svg(
            randomisation_figure([layer_name(layer) for layer in layers], lines),
            "sanity",
            "rank correlation with the explanations of the trained model, layer after layer shuffled",
        ),
        [
            Table(
                "Spearman's ρ with the explanation of the trained model, mean over places and runs",
                table,
                "Attention does not look past its own layer: shuffling the output can't change it.",
            ),
            Table(
                "Integrated Gradients from other baselines, and with more steps: ρ with zero; completeness gap",
                readable(
                    [
                        {k: v for k, v in row.items() if k not in ("way", "method")}
                        for row in rows
                        if row["way"] == "baseline"
                    ],
                    scope="baseline",
                ),
            ),
        ],
    )


def agreement(found: Introspection) -> Section:
    """Kendall's W of the runs, rank correlations between methods."""
    of_runs = [row for row in found.agreement if row["method"] != ALL_EXPLAINERS]
    steady = [row for row in of_runs if isinstance(row.get("kendall_w"), float)]
    words = "One run, or two classes: nothing can be said of agreement between runs. "
    if steady:
        top, least = max(steady, key=_w), min(steady, key=_w)
        words = (
            f"From training to training {plain(str(top['method']))} agrees with itself most (W = {_w(top):.2f}) and "
            f"{plain(str(least['method']))} least ({_w(least):.2f}); 1 is perfect, and rankings drawn at random have "
            f"{float(top['by_chance'] or 0):.2f}. "
        )
    between = [_w(row) for row in found.agreement if row["method"] == ALL_EXPLAINERS]
    if between:
        words += (
            f"In one and the same run the {len(found.methods)} explainers agree with W = "
            f"{' / '.join(f'{w:.2f}' for w in between)} (by chance {1 / len(found.methods):.2f})."
        )
    names = (ABLATION, *found.methods)
    matrix: list[Row] = [
        {"method": plain(one), **{plain(other): correlation(found.runs, one, other) for other in names}}
        for one in names
    ]
    return Section(
        "agreement",
        "Do runs and explainers agree?",
        words,
        tables=[
            Table(
                "Kendall's W; Spearman's ρ of the class scores with those of ablation",
                readable(found.agreement, kendall_w="Kendall's W", by_chance="W by chance", ablation="ρ with ablation"),
                "W by chance: what rankings drawn at random have, one over their number; p: how often such "
                "agree as much. ρ is over classes, of means over runs, with its 95 % interval.",
            ),
            Table("Spearman's ρ between the methods' class scores, mean over runs", matrix),
        ],
        wide=True,
        open=True,
    )


def frequency(found: Introspection) -> Section:
    """Importance and class frequency: the TF-IDF reading."""
    falls = [plain(str(row["method"])) for row in found.frequency if _below(row, "frequency")]
    rises = [plain(str(row["method"])) for row in found.frequency if _above(row, "frequency")]
    said = (
        f"An interval below zero, which would show it: {', '.join(falls) or 'none'}; one above zero, which says the "
        f"opposite: {', '.join(rises) or 'none'}"
    )
    return Section(
        "frequency",
        "Are rare classes worth more? (the TF-IDF reading)",
        "The paper reads its rankings like TF-IDF, the weighting of words by how few texts have them: the more "
        "frequent a class, the less one object of it counts. The rank correlation of what an object counts for with "
        f"class frequency would be negative. {said}.",
        tables=[
            Table(
                "Spearman's ρ over classes, of means over runs",
                readable(
                    found.frequency,
                    frequency="per object, frequency",
                    idf="per object, idf",
                    score_frequency="Table IV's score, frequency",
                ),
                "per object, frequency: what an object of the class counts for, over what it would if all in reach "
                "counted alike (ablation: loss of PR-AUC over frequency), with class frequency; per object, idf: with "
                "the logarithm of places over places that have the class in reach; "
                "Table IV's score, frequency: its scores with class frequency.",
            )
        ],
        wide=True,
        open=True,
    )


def layer_name(layer: str) -> str:
    """A part of the network as a reader takes it: ``layers.1`` is the second pass of messages."""
    part, _, number = layer.partition(".")
    return f"{LAYERS.get(part, plain(part))} {int(number) + 1}" if number.isdecimal() else LAYERS.get(part, plain(part))


def _w(row: Row) -> float:
    return float(row["kendall_w"] or 0.0)


def _figure(row: Row) -> float:
    return float(row.get("spearman") or 0.0) if "spearman" in row else float("nan")


def _below(row: Row, name: str) -> bool:
    return float(row[f"{name}_high"] or np.nan) < 0


def _above(row: Row, name: str) -> bool:
    return float(row[f"{name}_low"] or np.nan) > 0
