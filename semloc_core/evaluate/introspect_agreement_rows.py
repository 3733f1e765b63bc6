"""How far runs and explainers agree on the classes, and what their importance has to do with frequency, as rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core.evaluate.introspect_agreement import kendall_w, spearman
from semloc_core.evaluate.introspect_run import ABLATION, Run
from semloc_core.evaluate.rows import Row


def agreement_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """How far runs agree on the classes, what that has to do with frequency, and with what ablation says.

    ``kendall_w``: of the runs (with at least two, and three classes); ``frequency``: Spearman of importance per object
    with class frequency (TF–IDF would be negative); ``ablation``: Spearman of the score with ablation's, over
    classes and runs.
    """
    rows: list[Row] = []
    for method in (ABLATION, *methods):
        table = np.array([list(run.scores(method).values()) for run in runs])
        per_object = [
            value / run.frequency[name]
            for run in runs
            for name, value in (run.drop if method == ABLATION else run.importance[method]).items()
        ]
        frequency = [value for run in runs for value in run.frequency.values()]
        by_ablation = [value for run in runs for value in run.scores(ABLATION).values()]
        row: Row = {"method": method, "scope": "all"}
        if table.shape[0] >= 2 and table.shape[1] >= 3:
            row["kendall_w"] = kendall_w(table)
        for label, pair in (
            ("frequency", (per_object, frequency)),
            ("ablation", (table.ravel().tolist(), by_ablation)),
        ):
            if label == ABLATION and method == ABLATION:
                continue
            row[label], row[f"{label}_low"], row[f"{label}_high"] = spearman(*pair)
        rows.append(row)
    return rows


def explainer_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Rank correlations between the methods: a row a method, a column each other.

    Spearman's, of Table IV's scores over the classes, averaged over the runs; NaN where no run has a ranking.
    """
    names = (ABLATION, *methods)
    rows: list[Row] = []
    for one in names:
        row: Row = {"method": one, "scope": "all runs"}
        for other in names:
            each = [spearman(list(run.scores(one).values()), list(run.scores(other).values()))[0] for run in runs]
            row[other] = _mean(each)
        rows.append(row)
    return rows


def explainers_w(runs: Sequence[Run], methods: Sequence[str]) -> float:
    """Kendall's W of the explainers on a run's classes, mean over the runs; NaN for one, or for two classes."""
    tables = [np.array([list(run.scores(method).values()) for method in methods]) for run in runs]
    return _mean([kendall_w(t) for t in tables if t.shape[0] >= 2 and t.shape[1] >= 3])


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")
