"""Similarity of embeddings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MATRIX_VALUES = 2**22  # in float64: 32 MiB


def similarity_matrix(
    queries: NDArray[np.float32], places: NDArray[np.float32], decimals: int = 6
) -> NDArray[np.float32]:
    """Cosine similarity of unit rows, rounded.

    A matrix product gives equal columns values that differ in the last bits, by where they stand in a block, and each
    kind of processor others. The product is taken in float64, where those bits lie far below the digits that are kept:
    equal places have equal similarities, and every machine the same.

    Args:
        queries: (Q, D) float32 unit rows (a zero row has similarity 0 with everything).
        places: (M, D) float32 unit rows.
        decimals: kept digits.

    Returns:
        (Q, M) float32.

    """
    similarity = np.empty((len(queries), len(places)), dtype=np.float32)
    columns = np.ascontiguousarray(places.T, dtype=np.float64)
    step = max(1, _MATRIX_VALUES // max(1, len(places)))
    for start in range(0, len(queries), step):
        some = slice(start, start + step)
        similarity[some] = np.round(queries[some].astype(np.float64) @ columns, decimals)
    similarity += np.float32(0.0)  # -0.0 becomes 0.0
    return similarity
