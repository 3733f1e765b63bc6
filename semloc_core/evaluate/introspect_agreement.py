"""Do runs and explainers agree: Kendall's W, rank correlations with an interval."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from semloc_core.errors import ConfigError


def kendall_w(scores: ArrayLike) -> float:
    """Kendall's coefficient of concordance of m raters on n items: 1 where all rank alike, 0 for no agreement.

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
    fewer than four pairs, and all three where one side is constant.

    Args:
        x: (n,).
        y: (n,).

    Returns:
        Correlation, lower and upper bound.

    """
    from scipy.stats import spearmanr

    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    nan = float("nan")
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return nan, nan, nan
    rho = float(spearmanr(a, b).statistic)
    if len(a) < 4:
        return rho, nan, nan
    if abs(rho) >= 1:
        return rho, rho, rho
    half = 1.959964 * math.sqrt(1.06 / (len(a) - 3))
    return rho, math.tanh(math.atanh(rho) - half), math.tanh(math.atanh(rho) + half)
