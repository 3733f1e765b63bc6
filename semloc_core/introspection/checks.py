"""Which explainers can be trusted with a model: those that passed both checks, in a line each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core.introspection.sanity import mean_rows
from semloc_core.metrics import Row

MOST_ALIKE = 0.5
"""An explainer whose scores correlate by more than this with those of shuffled weights does not look at the weights."""


def check_rows(methods: Sequence[str], controls: Sequence[Row], sanity: Sequence[Row]) -> list[Row]:
    """What came of the checks, explainers that passed first.

    Args:
        methods: explainers.
        controls: of `semloc_core.introspection.controls.control_rows`.
        sanity: of `semloc_core.introspection.sanity.sanity_rows`, of all runs.

    Returns:
        A row an explainer: ``faithful`` is its verdict against a random one, ``shuffled`` the rank correlation with its
        own scores once all weights are shuffled (NaN of a model without weights: then the first check decides), and
        ``passed`` whether it is better than random and ``shuffled`` at most `MOST_ALIKE`.

    """
    of_random = {row["method"]: str(row["verdict"]) for row in controls if row["scope"] == "against random"}
    cascades = [row for row in mean_rows(sanity) if row["way"] == "cascading"]
    rows: list[Row] = []
    for method in methods:
        alike = [float(row.get("spearman") or np.nan) for row in cascades if row["method"] == method]
        shuffled = alike[-1] if alike else float("nan")  # by the last one, all layers are shuffled
        passed = of_random.get(method) == "better" and not shuffled > MOST_ALIKE
        rows.append(
            {
                "method": method,
                "scope": "checks",
                "faithful": of_random.get(method),
                "shuffled": shuffled,
                "passed": passed,
            }
        )
    return sorted(rows, key=lambda row: not row["passed"])


def check_lines(rows: Sequence[Row]) -> list[str]:
    """The same in words."""
    lines = []
    for row in rows:
        shuffled = float(row["shuffled"] if row["shuffled"] is not None else np.nan)
        weights = (
            "the model has no weights to shuffle"
            if np.isnan(shuffled)
            else f"correlates by {shuffled:.2f} with itself on shuffled weights (at most {MOST_ALIKE:g} passes)"
        )
        verdict = "passed" if row["passed"] else "NOT passed"
        lines.append(f"{row['method']}: {verdict}; {row['faithful']} than random; {weights}")
    return lines
