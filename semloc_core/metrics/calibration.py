"""How honest probabilities are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats
from semloc_core.metrics.rows import Row

BINS = 10
KEPT = 0.9
"""Share of the right answers that an acceptance threshold has to keep."""


def expected_calibration_error(probability: Floats, right: NDArray[np.bool_], bins: int = BINS) -> float:
    """Mean distance of what was said from what was so, over bins of equal width (Guo et al. 2017, equation 3).

    Args:
        probability: (N,) said, in [0, 1].
        right: (N,) so.
        bins: how many.

    Returns:
        In [0, 1]; NaN where N is 0.

    """
    if not len(probability):
        return float("nan")
    return float(sum(abs(said - so) * share for said, so, share in reliability(probability, right, bins)))


def reliability(probability: Floats, right: NDArray[np.bool_], bins: int = BINS) -> list[tuple[float, float, float]]:
    """The reliability diagram: mean probability, share of right answers and share of all, for each bin with any."""
    of = np.minimum((probability * bins).astype(np.int64), bins - 1)
    return [
        (float(probability[of == b].mean()), float(right[of == b].mean()), float((of == b).mean()))
        for b in range(bins)
        if (of == b).any()
    ]


def accepted_share(home: Floats, foreign: Floats, right: NDArray[np.bool_]) -> Row:
    """What a threshold on (Q,) scores that keeps `KEPT` of the right answers accepts of others; None where none is."""
    if not right.any():
        return {"foreign_accepted": None, "wrong_accepted": None}
    threshold = np.quantile(home[right], 1 - KEPT, method="lower")
    wrong = float((home[~right] >= threshold).mean()) if (~right).any() else None
    return {"foreign_accepted": float((foreign >= threshold).mean()), "wrong_accepted": wrong}
