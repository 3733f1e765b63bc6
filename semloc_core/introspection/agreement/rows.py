"""How far runs and explainers agree on the classes, and what their importance has to do with frequency, as rows.

The independent cases of a rank correlation are the classes: runs are trainings on one and the same building, so a
class's scores are averaged over them first. With few classes the intervals are wide, and rightly so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from semloc_core.graph import Floats
from semloc_core.introspection.agreement.ranks import concordance, named, spearman
from semloc_core.introspection.class_lift import lift, of_class
from semloc_core.introspection.run import ABLATION, Run
from semloc_core.metrics import Row

ALL_EXPLAINERS = "all explainers"


def agreement_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """How far runs agree on the classes, and with what ablation says.

    A row a method: ``kendall_w`` of the runs, what it is ``by_chance`` and how often chance does as well (``p``; runs
    of two and more, classes of three and more), and ``ablation``: Spearman's ρ of Table IV's scores with those of
    ablation. Then a row a run: ``kendall_w`` of all explainers.
    """
    rows: list[Row] = []
    by_ablation = mean_scores(runs, ABLATION)
    for method in (ABLATION, *methods):
        row: Row = {"method": method, "scope": "all runs", **_concordance([run.scores(method) for run in runs])}
        if method != ABLATION:
            row |= named("ablation", spearman(mean_scores(runs, method), by_ablation))
        rows.append(row)
    for number, run in enumerate(runs, start=1):
        said = _concordance([run.scores(method) for method in methods])
        if said:
            rows.append({"method": ALL_EXPLAINERS, "scope": f"run {number}", **said})
    return rows


def frequency_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """The paper's reading of its rankings as TF-IDF, put to the test: Spearman's ρ over the classes.

    A row a method. ``frequency``: what an object of the class counts for (`semloc_core.introspection.class_lift.lift`;
    of ablation, the loss of PR-AUC over frequency) with class frequency; negative if an object counts for less the more
    there are of its kind. ``idf``: the same with the logarithm of places over places that have the class in
    reach, as TF-IDF weighs a word; positive if it is right. ``score_frequency``: Table IV's scores with frequency.
    """
    first = runs[0]
    frequency = np.array(list(first.frequency.values()))
    idf = np.array([inverse_document_frequency(first, name) for name in first.frequency])
    rows: list[Row] = []
    for method in (ABLATION, *methods):
        per_object = mean_scores(runs, ABLATION) if method == ABLATION else _mean_lifts(runs, method)
        row: Row = {"method": method, "scope": f"{len(frequency)} classes"}
        row |= named("frequency", spearman(per_object, frequency))
        row |= named("idf", spearman(per_object, idf))
        row |= named("score_frequency", spearman(mean_scores(runs, method), frequency))
        rows.append(row)
    return rows


def explainer_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Rank correlations between the methods: a row a pair, ``method`` and ``other``.

    ``spearman`` is of Table IV's scores over the classes, averaged over the runs; NaN where no run has a ranking.
    """
    names = (ABLATION, *methods)
    return [
        {"method": one, "scope": "all runs", "other": other, "spearman": correlation(runs, one, other)}
        for i, one in enumerate(names)
        for other in names[i + 1 :]
    ]


def correlation(runs: Sequence[Run], one: str, other: str) -> float:
    """Spearman's ρ of two methods' scores over the classes, mean over the runs that have one."""
    each = [spearman(list(run.scores(one).values()), list(run.scores(other).values()))[0] for run in runs]
    known = [value for value in each if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


def mean_scores(runs: Sequence[Run], method: str) -> Floats:
    """(C,) Table IV's scores of the classes, mean over the runs."""
    found: Floats = np.mean([list(run.scores(method).values()) for run in runs], axis=0)
    return found


def inverse_document_frequency(run: Run, name: str) -> float:
    """The natural logarithm of places explained over those of them that have the class in reach (at least one)."""
    seen = run.introspection.seen
    return float(np.log(len(seen) / max(1, int(seen[:, of_class(run, [name])].any(axis=1).sum()))))


def _mean_lifts(runs: Sequence[Run], method: str) -> Floats:
    """(C,) lift of each class, mean over the runs."""
    each = [
        [lift(run, method, [name], np.ones(len(run.introspection.places))) for name in run.frequency] for run in runs
    ]
    found: Floats = np.mean(each, axis=0)
    return found


def _concordance(scores: Sequence[Mapping[str, float]]) -> Row:
    table = np.array([list(of.values()) for of in scores])
    if table.ndim != 2 or table.shape[0] < 2 or table.shape[1] < 3:
        return {}
    found = concordance(table)
    return {"kendall_w": found.w, "by_chance": found.by_chance, "p": found.p}
