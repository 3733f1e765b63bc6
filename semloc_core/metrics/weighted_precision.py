"""PR-AUC of weighted queries: for a bootstrap, which asks for it hundreds of times on the same similarities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats


class WeightedPrecision:
    """Average precision over all pairs; sorted once.

    Args:
        similarity: (Q, M).
        positive: (Q, M) bool.

    """

    def __init__(self, similarity: NDArray[np.float32], positive: NDArray[np.bool_]) -> None:
        order = np.argsort(-similarity, axis=None, kind="stable")
        values = similarity.ravel()[order]
        self._query = order // similarity.shape[1]
        self._positive = positive.ravel()[order]
        self._last = np.flatnonzero(np.append(values[1:] != values[:-1], True))  # equal values are one threshold

    def of(self, weight: Floats) -> float:
        """Average precision (scikit-learn's, with a weight for each query (Q,)); NaN where no pair is positive."""
        each = weight[self._query]
        found = np.cumsum(each * self._positive)[self._last]
        called = np.cumsum(each)[self._last]
        if len(found) == 0 or found[-1] == 0:
            return float("nan")
        gained = np.diff(found, prepend=0.0)
        some = called > 0
        return float((gained[some] * found[some] / called[some]).sum() / found[-1])
