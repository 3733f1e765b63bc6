"""Do runs and explainers agree: Kendall's W, rank correlations with an interval."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semloc_core.errors import ConfigError
from semloc_core.metrics import Row

DRAWS = 2000
"""Of the permutation test."""


@dataclass(frozen=True)
class Concordance:
    """How far m raters agree.

    Args:
        w: Kendall's W; NaN where every rater ties everything.
        by_chance: what rankings drawn at random have on average, 1/m: not 0, and for three raters a third.
        p: how often such rankings agree as much, of `DRAWS` drawn.

    """

    w: float
    by_chance: float
    p: float


def concordance(scores: ArrayLike, seed: int = 0) -> Concordance:
    """Kendall's W, and what it would be if nobody agreed.

    Args:
        scores: as of `kendall_w`.
        seed: of the permutation test.

    """
    from scipy.stats import rankdata

    table = np.asarray(scores, dtype=np.float64)
    w = kendall_w(table)
    if math.isnan(w):
        return Concordance(w, 1.0 / len(table), float("nan"))
    ranks: NDArray[np.float64] = rankdata(table, axis=1)
    drawn = np.random.default_rng([seed, 7]).permuted(np.broadcast_to(ranks, (DRAWS, *ranks.shape)), axis=2)
    # with the same ties W rises with the spread of the items' sums, and with nothing else
    as_much = int((drawn.sum(1).var(1) >= ranks.sum(0).var() - 1e-9).sum())
    return Concordance(w, 1.0 / len(table), (1 + as_much) / (1 + DRAWS))


def kendall_w(scores: ArrayLike) -> float:
    """Kendall's coefficient of concordance of m raters on n items: 1 where all rank alike; by chance about 1/m.

    From Friedman's χ² with ties corrected: W = χ² / (m (n - 1)).

    Args:
        scores: (m, n), a rater (a run, an explainer) a row; at least 2 raters and 3 items.

    Raises:
        ConfigError: fewer.

    """
    from scipy.stats import friedmanchisquare

    table = np.asarray(scores, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] < 2 or table.shape[1] < 3:
        raise ConfigError(f"expected scores of at least 2 raters on 3 items (got shape {table.shape})")
    m, n = table.shape
    if bool((table == table[:, :1]).all()):
        return float("nan")  # every rater ties everything: there is no ranking to agree on
    return float(friedmanchisquare(*table.T).statistic / (m * (n - 1)))


def spearman(x: ArrayLike, y: ArrayLike) -> tuple[float, float, float]:
    """Spearman's rank correlation with a 95 % interval.

    The interval is Fisher's, with the standard error √(1.06 / (n - 3)) of Fieller, Hartley and Pearson (1957); NaN for
    fewer than four pairs, and all three where one side is constant. A correlation of 1 or -1 would have no width: for
    the interval it is taken half-way to the next value that so many ranks can have, 1 - 12 / (n³ - n).

    Args:
        x: (n,). A pair with a NaN in it is left out.
        y: (n,).

    Returns:
        Correlation, lower and upper bound.

    """
    from scipy.stats import spearmanr

    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    known = ~(np.isnan(a) | np.isnan(b))
    a, b = a[known], b[known]
    nan = float("nan")
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return nan, nan, nan
    rho = float(spearmanr(a, b).statistic)
    if len(a) < 4:
        return rho, nan, nan
    most = 1.0 - 6.0 / (len(a) ** 3 - len(a))
    middle = math.atanh(min(max(rho, -most), most))
    half = 1.959964 * math.sqrt(1.06 / (len(a) - 3))
    return rho, min(rho, math.tanh(middle - half)), max(rho, math.tanh(middle + half))


def named(name: str, of: tuple[float, float, float]) -> Row:
    """A figure, its lower and its upper bound, as a row has them."""
    return {name: of[0], f"{name}_low": of[1], f"{name}_high": of[2]}
