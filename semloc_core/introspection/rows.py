"""The study's figures as rows: Table IV and what is behind it."""

from __future__ import annotations

from collections.abc import Sequence

from semloc_core.introspection.run import ABLATION, Run
from semloc_core.metrics import Row


def table_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Table IV and what is behind it: a row a method, run and class, then (fidelity) one a method, run and budget."""
    rows: list[Row] = []
    for number, run in enumerate(runs, start=1):
        for method in (ABLATION, *methods):
            scores = run.scores(method)
            for rank, name in enumerate(run.ranking(method), start=1):
                row: Row = {
                    "method": method,
                    "scope": name,
                    "run": number,
                    "rank": rank,
                    "frequency": run.frequency[name],
                    "score": scores[name],
                }
                if method == ABLATION:
                    row |= {"pr_auc_drop": run.drop[name]}
                else:
                    row |= {
                        "importance": run.importance[method][name],
                        "shift": run.shift[method][name],
                        "shift_of_rest": run.shift_of_rest[method][name],
                    }
                rows.append(row)
        for method, curve in run.introspection.fidelity.items():
            rows += [
                {
                    "method": method,
                    "scope": "all",
                    "run": number,
                    "budget": float(budget),
                    "necessity": float(curve.necessity[i]),
                    "sufficiency": float(curve.sufficiency[i]),
                    "characterisation": float(curve.characterisation[i]),
                }
                for i, budget in enumerate(curve.budgets)
            ]
    return rows


def ranking_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Table IV: a row a method and run, with the classes by falling score under the names 1, 2 and so on."""
    rows: list[Row] = []
    for method in (ABLATION, *methods):
        for number, run in enumerate(runs, start=1):
            row: Row = {"method": method, "scope": f"run {number}"}
            for rank, name in enumerate(run.ranking(method), start=1):
                row[str(rank)] = name
            rows.append(row)
    return rows
