"""Exact search: the places whose embeddings have the largest inner product with a query's.

The inner product of unit vectors is their cosine. A product over all rows finds the candidates; these few are then
scored again in float64. That costs microseconds and makes an answer independent of how the product rounds. For one
query it is summed dimension by dimension, for all rows alike: BLAS would round by the processor, the number of threads
and a row's position in memory. Equal embeddings thus have equal similarities, and ties go to the lower row.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semloc_core.errors import MapError

_BLOCK = 64  # values whose largest stands for all of them
_SCORED_AT_ONCE = 2**14
_BATCH_VALUES = 2**24  # similarities held at a time: 64 MiB


class ExactSearch:
    """Search over the rows of a matrix, of which a copy by columns is kept once it has been asked.

    Args:
        embeddings: (M, D) float32, C-contiguous.

    Raises:
        MapError: another dtype or layout, or a number that is not finite.

    """

    def __init__(self, embeddings: NDArray[np.float32]) -> None:
        if embeddings.ndim != 2 or embeddings.dtype != np.float32 or not embeddings.flags.c_contiguous:
            raise MapError(f"expected contiguous (M, D) float32 (got {embeddings.shape} {embeddings.dtype})")
        squares = np.einsum("md,md->m", embeddings, embeddings)
        largest = float(squares.max(initial=0.0))
        if not np.isfinite(squares).all() or largest > 1e30:
            raise MapError("expected finite embeddings (got NaN, infinity or a length above 1e15)")
        self.embeddings = embeddings
        self._length = largest**0.5

    def search(
        self, z: ArrayLike, k: int, mask: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The k most similar rows, by falling similarity, then by rising row.

        Args:
            z: (D,) one query or (B, D) several.
            k: how many; fewer come back where there are fewer.
            mask: (M,) bool; where it is false a row is left out.

        Returns:
            Rows (K,) or (B, K) int64 and similarities of the same shape, float32; K ≤ k.

        Raises:
            MapError: a wrong shape, a number that is not finite, k < 1.

        """
        rows, dimension = self.embeddings.shape
        queries = check_query(z, dimension, k, mask, rows)
        found = min(k, rows if mask is None else int(np.count_nonzero(mask)))
        indices = np.empty((len(queries), found), dtype=np.int64)
        similarities = np.empty((len(queries), found), dtype=np.float32)
        step = max(1, _BATCH_VALUES // max(1, rows))
        for start in range(0, len(queries) if found else 0, step):
            chunk = queries[start : start + step]
            rough = self._rough(chunk[0])[None] if len(chunk) == 1 else chunk @ self.embeddings.T
            for row, query in enumerate(chunk, start):
                best, exact = self._near_best(rough[row - start], query, found, mask)
                indices[row], similarities[row] = best[:found], exact[:found]
        if np.ndim(z) == 1:
            return indices[0], similarities[0]
        return indices, similarities

    def everywhere(
        self, z: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
        """The k most similar rows as of `search`, and (M,) similarities of all, from one pass over the matrix.

        The k agree with those of all, and equal embeddings have equal similarities.

        Raises:
            MapError: as `search`.

        """
        if z.shape != self.embeddings.shape[1:] or z.dtype != np.float32 or not np.isfinite(z).all() or k < 1:
            wanted = f"k of at least 1 and a finite query of {self.embeddings.shape[1]} float32"
            raise MapError(f"expected {wanted} (got {k} and {z.shape} {z.dtype})")
        rough = self._rough(z)
        rows, exact = self._near_best(rough, z, min(k, len(rough)), None)
        rough[rows] = exact  # also of those that tie with the k-th
        return rows[:k], exact[:k], rough

    def _rough(self, query: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M,) similarities, rounded alike everywhere: one dimension after the other, no two numbers in one step."""
        found: NDArray[np.float32] = np.einsum("d,dm->m", query, self._columns)
        return found

    @cached_property
    def _columns(self) -> NDArray[np.float32]:
        """(D, M): so that a step goes through all rows of the map."""
        return np.ascontiguousarray(self.embeddings.T)

    def _near_best(
        self, rough: NDArray[np.float32], query: NDArray[np.float32], k: int, mask: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The k best, and what could not be told from them by similarities (M,) that are rounded somehow."""
        if mask is not None:
            rough = np.where(mask, rough, np.float32(-np.inf))
        # What two float32 sums of D products can differ by, however they are ordered (twice the usual bound).
        length = float(np.sqrt(np.dot(query.astype(np.float64), query.astype(np.float64))))
        slack = np.float32(4 * self.embeddings.shape[1] * 2.0**-24 * self._length * length)
        candidates = np.flatnonzero(rough >= kth_largest(rough, k) - slack)
        exact = np.empty(len(candidates), dtype=np.float32)
        for start in range(0, len(candidates), _SCORED_AT_ONCE):  # few, but for a zero query they are all rows
            some = slice(start, start + _SCORED_AT_ONCE)
            exact[some] = (self.embeddings[candidates[some]].astype(np.float64) * query).sum(axis=1)
        order = np.lexsort((candidates, -exact))
        return candidates[order], exact[order]


def check_query(z: ArrayLike, dimension: int, k: int, mask: NDArray[np.bool_] | None, rows: int) -> NDArray[np.float32]:
    """Queries (B, D) of one (D,) or several; MapError where they, k or the mask do not fit a map of so many rows."""
    queries = np.atleast_2d(np.asarray(z, dtype=np.float32))
    if queries.ndim != 2 or queries.shape[1] != dimension:
        raise MapError(f"expected queries of shape ({dimension},) or (B, {dimension}) (got {np.shape(z)})")
    if not np.isfinite(queries).all() or np.abs(queries).max(initial=0.0) > 1e15:
        raise MapError("expected finite queries (got NaN, infinity or a number above 1e15)")
    if k < 1:
        raise MapError(f"expected k of at least 1 (got {k})")
    if mask is not None and (mask.shape != (rows,) or mask.dtype != np.bool_):
        raise MapError(f"expected a mask of shape ({rows},) bool (got {mask.shape} {mask.dtype})")
    return queries


def kth_largest(values: NDArray[np.float32], k: int) -> np.float32:
    """The k-th largest of (M,) values; of many most are below the k-th of the blocks' largest: not looked at."""
    blocks = len(values) // _BLOCK
    if blocks >= k:
        largest = values[: blocks * _BLOCK].reshape(blocks, _BLOCK).max(axis=1)
        values = values[values >= np.partition(largest, blocks - k)[blocks - k]]
    return np.float32(np.partition(values, len(values) - k)[len(values) - k])
