"""The section on the paper's three expectations of its classes."""

from __future__ import annotations

from collections.abc import Sequence

from semloc_core.introspection import overall
from semloc_core.metrics import Row
from semloc_core.report.introspection.sections import readable
from semloc_core.report.page import Section, Table

NAMES = {
    1: "frequent classes give broad but moderate signals",
    2: "rare classes are salient landmarks",
    3: "classes that move are weighted down",
}


def hypotheses(rows: Sequence[Row]) -> Section:
    """Verdicts first, then every claim with its interval."""
    found = overall(rows)
    said = "; ".join(f"({number}) {NAMES[number]}: {verdict}" for number, verdict in found.items())
    keep = ("method", "verdict", "figure", "figure_low", "figure_high", "null")
    tables = []
    for claim in dict.fromkeys(str(row["claim"]) for row in rows):
        of_claim = [row for row in rows if row["claim"] == claim]
        plain: list[Row] = [
            {**{k: row.get(k) for k in keep}, "decides": "yes" if row["decides"] else "no"} for row in of_claim
        ]
        tables.append(
            Table(
                f"Hypothesis {of_claim[0]['hypothesis']}, {of_claim[0]['scope']}: {claim}",
                readable(plain, null="if not so"),
            )
        )
    return Section(
        "hypotheses",
        "The paper's three expectations, tested",
        f"What the paper expects of classes before it measures: {said}. Supported or refuted means that the whole 95 % "
        "interval lies on one side of the null; the rows that decide are those of the most faithful explainer and of "
        "ablation.",
        tables=tables,
        wide=True,
        open=True,
    )
