"""The paper's own rankings (its Tables I and IV), put through the measures that its text reads out of them.

``python -m semloc_core.introspection.agreement.paper_table`` prints them: how far runs and explainers agree, and what
its rankings have to do with class frequency and with its ablation.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.introspection.agreement.ranks import concordance, named, spearman
from semloc_core.metrics import Row

COUNTS = {"CH": 28, "CO": 11, "CP": 35, "PL": 13, "PA": 8, "TC": 15}
"""Table I: chairs, couches, computers, plants, paintings, trash cans."""
RANKINGS: dict[str, tuple[str, ...]] = {
    "ablation": ("TC CO PA PL CH CP", "TC CO PL PA CH CO", "TC CO PL CH PA CP"),
    "saliency": ("PL TC CH CP CO PA", "PL CH CP TC CO PA", "PL TC CO CH CP PA"),
    "integrated_gradients": ("TC PL CH CP CO PA", "TC PL CH CO CP PA", "TC PL CH CO CP PA"),
    "shapley_sampling": ("CO PA TC PL CP CH", "CO PA TC CP CH PL", "CP CO CH TC PA PL"),
    "attention": ("CO PL TC PA CH CP", "CO PL TC PA CH CP", "CO PL TC PA CH CP"),
}
"""Table IV as printed, a string a run, the most important class first."""


def is_ranking(text: str) -> bool:
    """Whether every class is listed once; the paper's second row of ablation lists CO twice and CP not at all."""
    return sorted(text.split()) == sorted(COUNTS)


def paper_rows() -> list[Row]:
    """What the paper's table says of itself.

    Returns:
        A row a method, of the runs that list every class once: ``runs``, ``kendall_w`` with ``by_chance`` and ``p``
        (`semloc_core.introspection.agreement.ranks.concordance`), Spearman's ρ of the mean rank with class
        ``frequency`` (TF-IDF: negative) and with ``ablation``; then a row a run: the W of the four explainers.

    """
    scores = {m: np.array([_scores(t) for t in texts if is_ranking(t)]) for m, texts in RANKINGS.items()}
    count = list(COUNTS.values())
    ablation = scores["ablation"].mean(0)
    rows: list[Row] = []
    for method, of in scores.items():
        agreed = concordance(of)
        row: Row = {"method": method, "scope": "all runs", "runs": len(of), "kendall_w": agreed.w}
        row |= {"by_chance": agreed.by_chance, "p": agreed.p}
        row |= named("frequency", spearman(of.mean(0), count))
        if method != "ablation":
            row |= named("ablation", spearman(of.mean(0), ablation))
        rows.append(row)
    for run in range(3):
        agreed = concordance([of[run] for method, of in scores.items() if method != "ablation"])
        row = {"method": "all explainers", "scope": f"run {run + 1}", "runs": 1, "kendall_w": agreed.w}
        rows.append(row | {"by_chance": agreed.by_chance, "p": agreed.p})
    return rows


def _scores(text: str) -> NDArray[np.float64]:
    """(6,) in the order of `COUNTS`: 6 for the first of a ranking, 1 for the last."""
    order: Sequence[str] = text.split()
    return np.array([len(order) - order.index(name) for name in COUNTS], dtype=np.float64)


def main() -> None:
    """Print the rows."""
    from rich.console import Console

    from semloc_core.metrics import print_table

    print_table(paper_rows(), title="the paper's Table IV", console=Console(file=sys.stdout, width=140))


if __name__ == "__main__":
    main()
