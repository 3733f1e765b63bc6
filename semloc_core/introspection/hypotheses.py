"""The paper's three expectations of its classes (Section III), each as claims with a figure, an interval and a verdict.

1. Frequent classes give broad but moderate signals: wide coverage, and less than an equal share for each object.
2. Rare classes are salient landmarks: more than an equal share for each object, and losing them costs more.
3. Mobile classes are weighted down as their positions vary from traversal to traversal
   (`semloc_core.introspection.mobility_study`).

*Frequent* are the classes with more objects than the mean; *rare* are as many from the other end (with the paper's
counts: computer and chair; painting and couch). Shares are those of the most faithful explainer and, so that nobody
has to believe in it, of all others too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import embed_graph, similarity_matrix
from semloc_core.explain import BUDGET
from semloc_core.graph import Floats, Ints
from semloc_core.introspection.agreement.ranks import named
from semloc_core.introspection.class_ablation import without_class
from semloc_core.introspection.class_lift import lift, of_class
from semloc_core.introspection.mobility_study import MobilityRun
from semloc_core.introspection.run import ABLATION, Run
from semloc_core.metrics import Row, Statistic, WeightedPrecision, bootstrap, squares
from semloc_core.training import positive_pairs

DRAWS = 400


@dataclass(frozen=True)
class Claim:
    """What is said, and of which sign the figure less ``null`` must be for it: ``direction`` is 1 or -1."""

    hypothesis: int
    words: str
    null: float
    direction: int


COVERAGE = Claim(1, "frequent classes are in reach of more places than rare ones (difference)", 0.0, 1)
MODERATE = Claim(
    1, "an object of a frequent class has less than an equal share of importance (share / equal share)", 1.0, -1
)
SALIENT = Claim(2, "an object of a rare class has more than an equal share of importance (share / equal share)", 1.0, 1)
COSTLY = Claim(2, "losing a rare class costs more PR-AUC per frequency than losing a frequent one (difference)", 0.0, 1)
MOBILE = Claim(3, "importance of classes that move between traversals, less that of the same classes at rest", 0.0, -1)


def hypothesis_rows(
    runs: Sequence[Run], methods: Sequence[str], mobility: Sequence[MobilityRun], *, draws: int = DRAWS, seed: int = 0
) -> list[Row]:
    """Test every claim.

    Intervals are 95 % percentile bootstraps over trainings and, in each, over squares of the building.

    Args:
        runs: of the study.
        methods: explainers.
        mobility: runs of the third; none: it is not tested.
        draws: of the bootstrap.
        seed: of the bootstrap.

    Returns:
        A row a claim and method: ``hypothesis``, ``claim``, ``method``, ``scope`` (classes meant), ``figure``,
        ``figure_low``, ``figure_high``, ``null``, ``verdict``: supported, refuted or undecided. Rows of the most
        faithful explainer, and of ablation, have ``decides`` 1: a hypothesis stands if all its deciding claims do.

    """
    rng = np.random.default_rng([seed, 4])
    frequent, rare = frequent_and_rare(runs[0].frequency, _counts(runs[0]))
    best = most_faithful(runs, methods)
    blocks = [squares(run.query.place_positions[run.introspection.places]) for run in runs]
    rows: list[Row] = []

    def test(claim: Claim, method: str, scope: Sequence[str], of: Statistic, squares_of: Sequence[Ints]) -> None:
        figure = bootstrap(of, squares_of, draws, rng)
        row: Row = {"hypothesis": claim.hypothesis, "claim": claim.words, "method": method, "scope": ", ".join(scope)}
        row |= named("figure", figure) | {"null": claim.null, "verdict": verdict(claim, *figure[1:])}
        row |= {"decides": int(method in (best, ABLATION, "coverage"))}
        rows.append(row)

    test(
        COVERAGE,
        "coverage",
        frequent,
        lambda r, w: _coverage(runs[r], frequent, w) - _coverage(runs[r], rare, w),
        blocks,
    )
    for claim, names in ((MODERATE, frequent), (SALIENT, rare)):
        for method in methods:
            test(claim, method, names, lambda r, w, m=method, c=names: lift(runs[r], m, c, w), blocks)  # type: ignore[misc]
    losses = [_Losses(run, (*frequent, *rare)) for run in runs]
    judged = [squares(run.query.place_positions[run.judged]) for run in runs]
    test(
        COSTLY,
        ABLATION,
        rare,
        lambda r, w: losses[r].per_frequency(rare, w) - losses[r].per_frequency(frequent, w),
        judged,
    )
    if mobility:
        where = [squares(one.positions) for one in mobility]
        for method in mobility[0].change:
            test(
                MOBILE,
                method,
                mobility[0].group,
                lambda r, w, m=method: float(np.average(mobility[r].change[m], weights=w)),  # type: ignore[misc]
                where,
            )
    return rows


def overall(rows: Sequence[Row]) -> dict[int, str]:
    """Hypothesis -> its verdict: refuted where a deciding claim is, supported where all are."""
    found: dict[int, str] = {}
    for number in sorted({int(row["hypothesis"] or 0) for row in rows}):
        said = {str(row["verdict"]) for row in rows if row["hypothesis"] == number and row["decides"]}
        found[number] = "refuted" if "refuted" in said else "supported" if said == {"supported"} else "undecided"
    return found


def verdict(claim: Claim, low: float, high: float) -> str:
    """Supported where the whole interval is on the claim's side of the null, refuted where it is on the other."""
    if np.isnan(low) or np.isnan(high):
        return "undecided"
    above, below = low > claim.null, high < claim.null
    if not above and not below:
        return "undecided"
    return "supported" if above == (claim.direction > 0) else "refuted"


def frequent_and_rare(frequency: Mapping[str, float], counts: Mapping[str, int]) -> tuple[list[str], list[str]]:
    """Classes with more objects than the mean, and as many with the fewest; none in both."""
    order = sorted(frequency, key=lambda name: (-counts[name], name))
    mean = sum(counts.values()) / len(counts)
    frequent = [name for name in order if counts[name] > mean] or order[:1]
    rare = order[max(len(frequent), len(order) - len(frequent)) :]
    return frequent, rare


def most_faithful(runs: Sequence[Run], methods: Sequence[str]) -> str:
    """The explainer with the highest characterisation score at the fixed budget, mean over runs."""

    def score(method: str) -> float:
        curves = [run.introspection.fidelity[method] for run in runs]
        at = int(np.argmin(np.abs(curves[0].budgets - BUDGET)))
        return float(np.mean([curve.characterisation[at] for curve in curves]))

    return max(methods, key=score)


def _counts(run: Run) -> dict[str, int]:
    return {name: int(of_class(run, [name]).sum()) for name in run.frequency}


def _coverage(run: Run, names: Sequence[str], weight: Floats) -> float:
    """Part of the places with a class in reach, mean over the classes."""
    if weight.sum() == 0:
        return float("nan")
    seen = run.introspection.seen
    return float(np.mean([np.average(seen[:, of_class(run, [name])].any(1), weights=weight) for name in names]))


class _Losses:
    """PR-AUC with and without each class, of weighted queries."""

    def __init__(self, run: Run, names: Sequence[str]) -> None:
        self._frequency, space = run.frequency, run.model.labelspace
        at = (run.query.place_positions[run.judged], run.reference.place_positions[run.judged])
        positive = positive_pairs(*at, MATCH_RADIUS_M)

        def judge(name: str | None) -> WeightedPrecision:
            a, b = (g if name is None else without_class(g, space, name) for g in (run.query, run.reference))
            z = embed_graph(run.model, a)[run.judged], embed_graph(run.model, b)[run.judged]
            return WeightedPrecision(similarity_matrix(*z), positive)

        self._whole, self._without = judge(None), {name: judge(name) for name in names}

    def per_frequency(self, names: Sequence[str], weight: Floats) -> float:
        """Loss of PR-AUC divided by class frequency, mean over classes."""
        whole = self._whole.of(weight)
        return float(np.mean([(whole - self._without[name].of(weight)) / self._frequency[name] for name in names]))
