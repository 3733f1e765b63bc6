"""The sections of the page on a study of explanations: each a figure, a sentence on it, and its numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from semloc_core.evaluate.introspect_agreement import spearman
from semloc_core.evaluate.introspect_agreement_rows import agreement_rows, explainer_rows, explainers_w
from semloc_core.evaluate.introspect_rows import ranking_rows
from semloc_core.evaluate.introspect_run import ABLATION, Run
from semloc_core.evaluate.introspect_views import Matrices, plan_parts, similarity_to_map
from semloc_core.evaluate.rows import Row
from semloc_core.explain.explainers import CONTROLS
from semloc_core.explain.fidelity import BUDGET
from semloc_core.report.drawing import to_svg
from semloc_core.report.floor_plan import Plan, similarity_figure
from semloc_core.report.introspection_figures import (
    FidelityCurves,
    fidelity_figure,
    importance_figure,
    matrices_figure,
    shift_figure,
)
from semloc_core.report.page import Section, Table


def rankings(runs: Sequence[Run], methods: Sequence[str]) -> Section:
    """Table IV."""
    firsts = Counter(run.ranking(method)[0] for run in runs for method in (ABLATION, *methods))
    lasts = Counter(run.ranking(method)[-1] for run in runs for method in (ABLATION, *methods))
    (first, times), (last, last_times) = firsts.most_common(1)[0], lasts.most_common(1)[0]
    total = sum(firsts.values())
    return Section(
        "rankings",
        "Which classes matter, by whom and in which run (Table IV)",
        f"Each row puts the classes in order, the most important first: {first} leads {times} of {total} rows, "
        f"{last} is "
        f"last in {last_times}. Where the rows of one method differ, a second training would have told another story.",
        tables=[
            Table(
                "classes by falling importance",
                ranking_rows(runs, methods),
                "ablation: loss of PR-AUC without the class, divided by its frequency. Explainers: shift of importance "
                "(Jensen–Shannon divergence) when the class is removed, divided by its frequency.",
            )
        ],
        wide=True,
        open=True,
    )


def importance(run: Run, methods: Sequence[str]) -> Section:
    """The paper's figure of object importance, of the first run."""
    space = run.model.labelspace
    known = np.flatnonzero(run.query.object_classes >= 0)
    classes = [space.classes[int(run.query.object_classes[i])] for i in known]
    values = {method: run.introspection.importance[method][known] for method in methods}
    order = by_count(run)
    half = {m: int(np.searchsorted(np.cumsum(-np.sort(-v)), 0.5 * v.sum())) + 1 for m, v in values.items()}
    fewest = min(half, key=lambda m: half[m])
    rows: list[Row] = [
        {
            "method": method,
            "scope": name,
            "objects": classes.count(name),
            "share of all importance": run.importance[method][name],
            "share of objects": run.frequency[name],
        }
        for method in methods
        for name in order
    ]
    return Section(
        "importance",
        "How much each object matters",
        f"One mark an object, in the same order in every panel: a few tall marks on the left and a long low tail "
        f"mean that "
        f"few objects carry localisation. By {fewest}, {half[fewest]} of {len(known)} objects carry half of all "
        f"importance.",
        to_svg(
            importance_figure(classes, values, order), "importance", "importance of every object, a panel an explainer"
        ),
        [Table("importance by class, first run", rows)],
        wide=True,
    )


def shift(runs: Sequence[Run], method: str) -> Section:
    """The paper's scatter of change in PR-AUC against the shift of attention."""
    names = by_count(runs[0])
    x = np.array([[run.scores(method)[name] for run in runs] for name in names])
    y = np.array([[run.scores(ABLATION)[name] for run in runs] for name in names])
    rho, low, high = spearman(x.ravel(), y.ravel())
    words = f"Spearman ρ = {rho:.2f} [{low:.2f}, {high:.2f}]"
    rows: list[Row] = [
        {
            "scope": name,
            "run": number + 1,
            "shift / frequency": float(x[i, number]),
            "PR-AUC loss / frequency": float(y[i, number]),
        }
        for i, name in enumerate(names)
        for number in range(len(runs))
    ]
    verdict = (
        "an interval above zero would make it a signal to trust; this one is"
        if low > 0
        else "an interval that holds zero, as this one does, is no evidence of it:"
    )
    tail = f" {verdict} {words}." if low <= 0 else f" {verdict}: {words}."
    return Section(
        "shift",
        f"Does {method} know what localisation needs?",
        f"To the right: classes whose removal changes {method} most; upwards: classes whose removal costs most "
        f"precision. "
        f"If {method} said what the model needs, the marks would rise from left to right;{tail}",
        to_svg(shift_figure(names, x, y, words), "shift", f"change in PR-AUC against shift of {method}"),
        [Table(f"a row a class and run; {words}", rows, "The interval takes classes and runs as independent cases.")],
    )


def fidelity(runs: Sequence[Run]) -> Section:
    """The three fidelity curves, means over the runs, with the controls."""
    budgets = next(iter(runs[0].introspection.fidelity.values())).budgets
    at = int(np.argmin(np.abs(budgets - BUDGET)))
    names = list(runs[0].introspection.fidelity)
    controls = {*CONTROLS, "inverted"}
    values = {
        name: {
            part: np.array([getattr(run.introspection.fidelity[name], part) for run in runs])
            for part in ("necessity", "sufficiency", "characterisation")
        }
        for name in names
    }
    score = {name: float(values[name]["characterisation"][:, at].mean()) for name in names}
    real = [name for name in names if name not in controls]
    best = max(real, key=lambda name: score[name])
    beaten = [name for name in real if score[name] <= score["random"]]
    said = (
        f"every explainer beats the random one ({score['random']:.3f})"
        if not beaten
        else f"no better than the random one ({score['random']:.3f}): {', '.join(beaten)}"
    )
    rows: list[Row] = [
        {
            "method": name,
            "scope": "all",
            "budget": float(budget),
            **{
                key: value
                for part, of in values[name].items()
                for key, value in ((part, float(of[:, b].mean())), (f"{part}_std", float(of[:, b].std())))
            },
        }
        for name in names
        for b, budget in enumerate(budgets)
    ]
    return Section(
        "fidelity",
        "Can the explanations be trusted?",
        "Take away the objects that an explainer puts first and the similarity should fall (necessity); keep "
        "only them and "
        f"it should stay (sufficiency); the score sums up both. At a budget of {BUDGET:g}, {best} is best with "
        f"{score[best]:.3f}; {said}. Faint lines are controls: random, and the first explainer upside down.",
        to_svg(
            fidelity_figure(
                budgets,
                {
                    name: FidelityCurves(**{p: v.mean(0) for p, v in values[name].items()}, control=name in controls)
                    for name in names
                },
            ),
            "fidelity",
            "necessity, sufficiency and characterisation score over the budget",
        ),
        [Table("means over the runs, ± their deviation", rows)],
    )


def plan(run: Run, place: int) -> Section:
    """The floor plan coloured by similarity to a query."""
    space, reference = run.model.labelspace, run.reference
    at, edges = plan_parts(reference)
    objects = {
        space.classes[c]: reference.object_positions[reference.object_classes == c, :2]
        for c in np.unique(reference.object_classes[reference.object_classes >= 0]).tolist()
    }
    values = similarity_to_map(run, place)
    query = run.query.place_positions[place]
    apart = np.linalg.norm(reference.place_positions - query, axis=1)
    top = np.argsort(-values, kind="stable")[:10]
    rows: list[Row] = [
        {
            "rank": rank,
            "place": reference.place_ids[i],
            "similarity": float(values[i]),
            "distance (m)": float(apart[i]),
        }
        for rank, i in enumerate(top.tolist(), start=1)
    ]
    near = sum(1 for i in top if apart[i] <= 4.0)
    return Section(
        "plan",
        "Where the map looks like the query",
        f"Every place of the map, coloured by its cosine similarity to the query at the star: bright spots far "
        f"from it are "
        f"places that could be mistaken for it. Of the ten most similar places {near} lie within 4 m of the query.",
        to_svg(
            similarity_figure(Plan(reference.name, at, edges, objects), values, query[:2]),
            "plan",
            "floor plan, places coloured by similarity to a query",
        ),
        [Table("the ten most similar places", rows)],
    )


def place_query_matrices(found: Matrices) -> Section:
    """Truth, bag of words and model."""
    ours = [name for name in found.similarity if name != "bag_of_words"][-1]
    rows: list[Row] = []
    for name, matrix in found.similarity.items():
        right, wrong = matrix[found.truth], matrix[~found.truth]
        rows.append(
            {
                "method": name,
                "scope": "test places",
                "PR-AUC": found.pr_auc[name],
                "mean similarity, right": float(right.mean()) if right.size else None,
                "mean similarity, wrong": float(wrong.mean()) if wrong.size else None,
            }
        )
    return Section(
        "matrices",
        "Places against queries",
        "Bright where a query (row) and a place of the map (column) are alike; neighbours stand beside each "
        "other, so right "
        f"answers lie along the diagonal of the first matrix, and the others should look like it. PR-AUC: bag of words "
        f"{found.pr_auc['bag_of_words']:.3f}, {ours} {found.pr_auc[ours]:.3f}.",
        to_svg(
            matrices_figure(
                {
                    "truth": found.truth.astype(np.float64),
                    "bag of words": found.similarity["bag_of_words"],
                    ours: found.similarity[ours],
                }
            ),
            "matrices",
            "place-query matrices: truth, bag of words, model",
        ),
        [Table(f"{len(found.places)} held-out places", rows)],
        wide=True,
    )


def agreement(runs: Sequence[Run], methods: Sequence[str]) -> Section:
    """Kendall's W of the runs, rank correlations between methods."""
    keep = ("method", "scope", "kendall_w", "ablation", "ablation_low", "ablation_high")
    rows = [{k: v for k, v in row.items() if k in keep} for row in agreement_rows(runs, methods)]
    steady = [row for row in rows if isinstance(row.get("kendall_w"), float)]
    words = "One run, so nothing is said of agreement between runs. "
    if steady:
        top = max(steady, key=lambda row: float(row["kendall_w"] or 0.0))
        least = min(steady, key=lambda row: float(row["kendall_w"] or 0.0))
        words = (
            f"Over the runs {top['method']} agrees with itself most (W = {float(top['kendall_w'] or 0.0):.2f}) and "
            f"{least['method']} least ({float(least['kendall_w'] or 0.0):.2f}); 1 is perfect, 0 is chance. "
        )
    w = explainers_w(runs, methods)
    return Section(
        "agreement",
        "Do runs and explainers agree?",
        f"{words}In one run the explainers agree with each other with W = {w:.2f}.",
        tables=[
            Table("Kendall's W over the runs; Spearman's ρ with ablation over classes and runs", rows),
            Table("Spearman's ρ between the methods' class scores, mean over runs", explainer_rows(runs, methods)),
        ],
        wide=True,
        open=True,
    )


def frequency(runs: Sequence[Run], methods: Sequence[str]) -> Section:
    """Importance and class frequency: the TF–IDF reading."""
    keep = ("method", "scope", "frequency", "frequency_low", "frequency_high")
    rows = [{k: v for k, v in row.items() if k in keep} for row in agreement_rows(runs, methods)]
    inverse = [str(row["method"]) for row in rows if float(row.get("frequency_high") or np.nan) < 0]
    said = (
        f"that holds, with an interval below zero, for {', '.join(inverse)}" if inverse else "that holds for none here"
    )
    return Section(
        "frequency",
        "Are rare classes worth more? (the TF–IDF reading)",
        "The paper reads its rankings like TF–IDF: the more frequent a class, the less one instance of it "
        "matters. The rank "
        f"correlation of importance per object with frequency would then be negative; {said}.",
        tables=[
            Table(
                "Spearman's ρ of importance per object with class frequency, over classes and runs",
                rows,
                "ablation: loss of PR-AUC per object.",
            )
        ],
        open=True,
    )


def by_count(run: Run) -> list[str]:
    """Classes, the most frequent first: a class looks alike in all figures."""
    return sorted(run.frequency, key=lambda name: (-run.frequency[name], name))
