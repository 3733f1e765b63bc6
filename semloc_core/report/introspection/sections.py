"""The sections of the page on a study of explanations: each a figure, a sentence on it, and its numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from semloc_core.introspection import ABLATION, Matrices, Run, plan_parts, ranking_rows, similarity_to_map, spearman
from semloc_core.metrics import HIGH, LOW, STD, Row
from semloc_core.report.colours import ClassLooks
from semloc_core.report.drawing import to_svg
from semloc_core.report.floor_plan import Plan, similarity_figure
from semloc_core.report.introspection.figures import (
    importance_figure,
    matrix_figure,
    shift_figure,
)
from semloc_core.report.page import Section, Table


def plain(method: str) -> str:
    """A method's name as a reader takes it."""
    return method.replace("_", " ")


def readable(rows: Sequence[Row], **names: str) -> list[Row]:
    """Rows with names for readers: underscores as spaces, in methods too; columns as ``names`` says.

    Deviations and bounds (`semloc_core.metrics.table`) keep their endings, so that they stay in their figure's cell. A
    scope that is the same in all rows is left out.
    """
    dull = len({row.get("scope") for row in rows}) == 1
    found: list[Row] = []
    for row in rows:
        told: Row = {}
        for key, value in row.items():
            if key == "scope" and dull:
                continue
            ending = next((end for end in (STD, LOW, HIGH) if key.endswith(end)), "")
            name = key.removesuffix(ending)
            text = isinstance(value, str) and key in ("method", "other")
            told[names.get(name, plain(name)) + ending] = plain(str(value)) if text else value
        found.append(told)
    return found


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
                readable(ranking_rows(runs, methods), scope="run"),
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
    order = by_weight(run)
    half = {m: int(np.searchsorted(np.cumsum(-np.sort(-v)), 0.5 * v.sum())) + 1 for m, v in values.items()}
    fewest = min(half, key=lambda m: half[m])
    rows: list[Row] = [
        {
            "method": plain(method),
            "class": name,
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
        f"few objects carry localisation. By {plain(fewest)}, {half[fewest]} of {len(known)} objects carry half of all "
        f"importance.",
        to_svg(
            importance_figure(classes, values, ClassLooks(space.classes, order)),
            "importance",
            "importance of every object, a panel an explainer",
        ),
        [Table("importance by class, first run", rows)],
        wide=True,
    )


def shift(runs: Sequence[Run], method: str) -> Section:
    """The paper's scatter of change in PR-AUC against the shift of attention."""
    names = by_weight(runs[0])
    x = np.array([[run.scores(method)[name] for run in runs] for name in names])
    y = np.array([[run.scores(ABLATION)[name] for run in runs] for name in names])
    rho, low, high = spearman(x.mean(1), y.mean(1))
    over = f"{len(names)} classes, means over {len(runs)} run{'s' * (len(runs) > 1)}"
    words = f"Spearman ρ = {rho:.2f} [{low:.2f}, {high:.2f}], {over}"
    each = [spearman(x[:, r], y[:, r])[0] for r in range(len(runs))]
    rows: list[Row] = [
        {
            "class": name,
            "run": number + 1,
            "shift / frequency": float(x[i, number]),
            "PR-AUC loss / frequency": float(y[i, number]),
        }
        for i, name in enumerate(names)
        for number in range(len(runs))
    ]
    verdict = (
        "The interval is above zero: it does"
        if low > 0
        else "The interval is below zero: it says the opposite"
        if high < 0
        else "The interval holds zero, so this building is no evidence that it does"
    )
    return Section(
        "shift",
        f"Does {plain(method)} know what localisation needs?",
        f"To the right: classes whose removal changes {plain(method)} most; upwards: classes whose removal costs most "
        f"precision, both for their number. If {plain(method)} said what the model needs, the marks would rise from "
        f"left to right. {verdict}. {words}.",
        to_svg(
            shift_figure(ClassLooks(runs[0].model.labelspace.classes, names), x, y, words),
            "shift",
            f"change in PR-AUC against shift of {plain(method)}; {words}",
        ),
        [
            Table(
                "a row a class and run",
                rows,
                "ρ in each run: " + ", ".join(f"{value:.2f}" for value in each) + ". The interval takes classes as "
                "the independent cases: runs are trainings on one building.",
            )
        ],
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
    drawn: dict[str, ArrayLike] = {"truth": found.truth.astype(np.float64)}
    ours = [name for name in found.similarity if name != "bag_of_words"][-1]
    drawn |= {name: found.similarity[name] for name in ("bag_of_words", ours)}
    rows: list[Row] = []
    for name, matrix in found.similarity.items():
        right, wrong = matrix[found.truth], matrix[~found.truth]
        rows.append(
            {
                "method": plain(name),
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
        f"{found.pr_auc['bag_of_words']:.3f}, {plain(ours)} {found.pr_auc[ours]:.3f}.",
        "".join(
            to_svg(matrix_figure(plain(title), matrix), f"matrix-{number}", f"place-query matrix: {plain(title)}")
            for number, (title, matrix) in enumerate(drawn.items())
        ),
        [Table(f"{len(found.places)} held-out places", rows)],
        wide=True,
    )


def by_weight(run: Run) -> list[str]:
    """Classes by what one object of theirs counts for, mean over the explainers: those are named that matter."""

    def weight(name: str) -> float:
        return sum(of[name] for of in run.importance.values()) / run.frequency[name]

    return sorted(run.frequency, key=lambda name: (-weight(name), name))
