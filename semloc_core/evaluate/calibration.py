"""How honest probabilities are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph_arrays import Floats

BINS = 10


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
