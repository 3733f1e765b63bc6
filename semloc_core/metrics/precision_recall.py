"""The figures that retrieval and classification are judged by.

The paper has two views. *Classification*: every pair (query, map place) is a case; PR-AUC and F1 are
scikit-learn's. *Retrieval*: Recall@N, which the paper words as the probability that a correct match is among the
first N (success@N here). Its figures, though, can only be positives found ÷ all positives: Recall@1 is half as large
on the validation split (8.6 %) as on the test split (18.2 %), which has half as many places and so half as many
positives a query; a ceiling of one found among eleven, or among five or six, explains both. So all three are
computed: recall@N as in information retrieval, the most that it could be (recall_ceiling@N), and success@N.

Equal similarities are ranked by index, so that a figure does not depend on a sort's whims.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import ConfigError
from semloc_core.graph import Ints
from semloc_core.metrics.rows import Row

Similarities = NDArray[np.float32]
Bools = NDArray[np.bool_]

RANKS = (1, 5, 10)


def pr_auc(similarity: Similarities, positive: Bools) -> float:
    """Area under the precision–recall curve over all pairs (scikit-learn's average precision).

    Args:
        similarity: (Q, M) float32.
        positive: (Q, M) bool, the pairs that are the same place.

    Returns:
        Average precision, or NaN where no pair is positive.

    """
    from sklearn.metrics import average_precision_score

    _check_pair(similarity, positive)
    if not positive.any():
        return float("nan")
    return float(average_precision_score(positive.ravel(), similarity.ravel()))


def fit_threshold(similarity: Similarities, positive: Bools) -> float:
    """Threshold with the best F1 over all pairs; of equally good ones the highest.

    Fit it on the validation split and give it to `f1_at` on the test split.

    Args:
        similarity: (Q, M) float32.
        positive: (Q, M) bool.

    Raises:
        ConfigError: no pair is positive.

    """
    from sklearn.metrics import precision_recall_curve

    _check_pair(similarity, positive)
    if not positive.any():
        raise ConfigError("expected at least one positive pair to fit a threshold on (got none)")
    precision, recall, thresholds = precision_recall_curve(positive.ravel(), similarity.ravel())
    precision, recall = precision[:-1], recall[:-1]  # the last point of the curve has no threshold
    f1 = 2 * precision * recall / np.maximum(precision + recall, np.finfo(np.float64).tiny)
    return float(thresholds[np.flatnonzero(f1 == f1.max())[-1]])


def f1_at(similarity: Similarities, positive: Bools, threshold: float) -> float:
    """F1 over all pairs of calling a pair the same place where similarity ≥ ``threshold``."""
    from sklearn.metrics import f1_score

    _check_pair(similarity, positive)
    called = (similarity >= np.float32(threshold)).ravel()
    return float(f1_score(positive.ravel(), called, zero_division=0.0))


def top(similarity: Similarities, n: int) -> Ints:
    """Indices of the ``n`` most similar columns of each row, best first, ties by index.

    Args:
        similarity: (Q, M) float32.
        n: how many; fewer come back where M < n.

    Returns:
        (Q, min(n, M)) int64.

    """
    n_queries, n_places = similarity.shape
    n = min(n, n_places)
    if n == 0 or n_queries == 0:
        return np.empty((n_queries, n), dtype=np.int64)
    # Partition first: only what is at least as good as the n-th best needs sorting.
    nth = np.partition(similarity, n_places - n, axis=1)[:, n_places - n]
    best = np.empty((n_queries, n), dtype=np.int64)
    for i, row in enumerate(similarity):
        candidates = np.flatnonzero(row >= nth[i])
        best[i] = candidates[np.argsort(-row[candidates], kind="stable")[:n]]
    return best


def hits(similarity: Similarities, positive: Bools, ranks: Sequence[int] = RANKS) -> Ints:
    """How many positives are among the first N of each query, for each N of ``ranks``: (Q, R) int64."""
    _check_pair(similarity, positive)
    best = top(similarity, max(ranks))
    found = np.cumsum(np.take_along_axis(positive, best, axis=1), axis=1, dtype=np.int64)
    last = np.minimum(np.array(ranks), max(best.shape[1], 1)) - 1
    if best.shape[1] == 0:
        return np.zeros((len(similarity), len(ranks)), dtype=np.int64)
    return found[:, last]


def retrieval(similarity: Similarities, positive: Bools, ranks: Sequence[int] = RANKS) -> dict[str, float]:
    """Recall, its ceiling and success at each rank, averaged over the queries that have a positive.

    For a query with K positives of which F are among the first N: recall@N = F / K, recall_ceiling@N = min(N, K) / K,
    success@N = 1 if F > 0.

    Args:
        similarity: (Q, M) float32.
        positive: (Q, M) bool.
        ranks: the N.

    Returns:
        ``recall@N``, ``recall_ceiling@N``, ``success@N`` for each N, and ``queries``, how many were averaged;
        NaN where no query has a positive.

    """
    count = positive.sum(axis=1)
    asked = count > 0
    found = hits(similarity, positive, ranks)[asked]
    count = count[asked]
    figures: dict[str, float] = {}
    for column, n in enumerate(ranks):
        figures[f"recall@{n}"] = _mean(found[:, column] / count)
        figures[f"recall_ceiling@{n}"] = _mean(np.minimum(n, count) / count)
        figures[f"success@{n}"] = _mean(found[:, column] > 0)
    figures["queries"] = int(asked.sum())
    return figures


def bootstrap_interval(
    values: NDArray[np.generic],
    rng: np.random.Generator,
    *,
    groups: Ints | None = None,
    resamples: int = 1000,
    level: float = 0.95,
) -> tuple[float, float]:
    """Percentile bootstrap interval of a mean.

    Args:
        values: (Q,) one figure a query.
        rng: source of the resamples.
        groups: (Q,) group of each query, or None. None, or one group alone, resamples queries: the interval speaks of
            other queries in the same buildings. With groups (buildings) whole groups are resampled: it speaks of other
            buildings, and is wider, since queries of one building share its difficulty.
        resamples: number of resamples.
        level: coverage.

    Returns:
        Lower and upper end; NaN where there are no values.

    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) == 0:
        return float("nan"), float("nan")
    if groups is None or len(np.unique(groups)) == 1:
        sums, sizes = values, np.ones(len(values))
    else:
        _, index = np.unique(groups, return_inverse=True)
        sums, sizes = np.bincount(index, weights=values), np.bincount(index).astype(np.float64)
    means = np.empty(resamples)
    for i in range(resamples):
        drawn = rng.integers(len(sums), size=len(sums))
        means[i] = sums[drawn].sum() / sizes[drawn].sum()
    tail = (1.0 - level) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return float(low), float(high)


def with_interval(name: str, values: NDArray[np.generic], rng: np.random.Generator, groups: Ints | None = None) -> Row:
    """``name``, the mean of a figure of each query (Q,), and ``name_low`` and ``name_high``: `bootstrap_interval`."""
    low, high = bootstrap_interval(values, rng, groups=groups)
    return {name: _mean(values), f"{name}_low": low, f"{name}_high": high}


def success_figures(
    right: Bools, rng: np.random.Generator, groups: Ints | None = None, ranks: Sequence[int] = RANKS
) -> Row:
    """success@N with its interval, for each N of ``ranks``, of matches (Q, M) that are right or not, best first."""
    row = Row()
    for n in ranks:
        success: Bools = right[:, :n].max(axis=1)
        row |= with_interval(f"success@{n}", success, rng, groups)
    return row


def mean_and_deviation(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each figure over repetitions (seeds); ``<figure>_std`` is its sample deviation (0 for one row).

    Every row must have the same figures.
    """
    if not rows:
        raise ConfigError("expected at least one repetition (got none)")
    figures: dict[str, float] = {}
    for name in rows[0]:
        values = np.array([row[name] for row in rows], dtype=np.float64)
        figures[name] = float(values.mean())
        figures[f"{name}_std"] = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return figures


def _mean(values: NDArray[np.generic]) -> float:
    return float(values.astype(np.float64).mean()) if len(values) else float("nan")


def _check_pair(similarity: Similarities, positive: Bools) -> None:
    assert similarity.dtype == np.float32, similarity.dtype
    assert positive.dtype == np.bool_, positive.dtype
    assert similarity.shape == positive.shape, (similarity.shape, positive.shape)
