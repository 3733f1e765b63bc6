"""Does an explainer beat the controls: its characterisation score less theirs, place by place, with an interval."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core.explain import BUDGET, CONTROLS
from semloc_core.introspection.agreement.ranks import named
from semloc_core.introspection.run import Run
from semloc_core.introspection.whole_map import INVERTED
from semloc_core.metrics import Row, bootstrap, squares

DRAWS = 400


def control_rows(runs: Sequence[Run], methods: Sequence[str], *, draws: int = DRAWS, seed: int = 0) -> list[Row]:
    """Compare every explainer with every control at the fixed budget.

    Args:
        runs: of the study.
        methods: explainers.
        draws: of the bootstrap over runs and, in each, over squares of the building.
        seed: of the bootstrap.

    Returns:
        A row an explainer and control: ``method``, ``scope`` (``against random`` …), ``budget``, ``better_by`` with its
        95 % interval, and ``verdict``: better where the whole interval is above zero, worse where it is below, else
        no better.

    """
    rng = np.random.default_rng([seed, 8])
    where = [squares(run.query.place_positions[run.introspection.places]) for run in runs]
    rows: list[Row] = []
    for control in (*CONTROLS, INVERTED):
        for method in methods:
            if any(control not in run.introspection.characterisation for run in runs):
                continue
            better = [
                run.introspection.characterisation[method] - run.introspection.characterisation[control] for run in runs
            ]
            found = bootstrap(
                lambda r, weight, of=better: float(np.average(of[r], weights=weight)) if weight.sum() else np.nan,  # type: ignore[misc]
                where,
                draws,
                rng,
            )
            verdict = "better" if found[1] > 0 else "worse" if found[2] < 0 else "no better"
            row: Row = {"method": method, "scope": f"against {control}", "budget": BUDGET}
            rows.append(row | named("better_by", found) | {"verdict": verdict})
    return rows
