"""Approximate search for maps of more than a million places: inverted lists (faiss, an extra).

Places are grouped around centroids; a query goes through the lists of the nearest centroids alone (Sivic and Zisserman,
"Video Google", ICCV 2003; Johnson, Douze and Jégou, "Billion-scale similarity search with GPUs", 2019). How many lists
is settled when the index is made, by what it finds of the truth: `InvertedSearch.recall`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semloc_core.errors import MapError
from semloc_core.map_database.search.exact import ExactSearch, check_query

LARGE = 1_000_000
"""Places beyond which a map's search is approximate where faiss is installed; see docs/benchmark.md."""
WANTED = 0.98
"""Recall@10 that the number of lists is chosen for."""
_K = 10
_SAMPLE = 200  # queries that recall is measured on
_PER_LIST = 64  # embeddings for each centroid to be trained on


class InvertedSearch:
    """Search over the rows of a matrix: most of what `ExactSearch` would find, scored as it does.

    Args:
        embeddings: (M, D) float32, C-contiguous, of unit length; not copied, but faiss keeps its own.
        wanted: recall@10 to be reached on queries like the map's own places.
        seed: of the sample that centroids are trained on and recall is measured with.

    Attributes:
        recall: the share of the 10 nearest that it finds, on perturbed places of the map.
        lists: how many there are.
        probes: lists that a query goes through.

    Raises:
        MapError: as of `ExactSearch`, or faiss is not installed.

    """

    def __init__(self, embeddings: NDArray[np.float32], wanted: float = WANTED, seed: int = 0) -> None:
        self.embeddings = embeddings
        self._exact = ExactSearch(embeddings)
        rows, dimension = embeddings.shape
        rng = np.random.default_rng(seed)
        lists = max(1, min(4096, round(rows**0.5)))
        trained = np.sort(rng.choice(rows, size=min(rows, lists * _PER_LIST), replace=False))
        faiss = _faiss()
        self._index = faiss.IndexIVFFlat(faiss.IndexFlatIP(dimension), dimension, lists, faiss.METRIC_INNER_PRODUCT)
        self._index.cp.seed = seed
        self._index.cp.niter = 10
        self._index.train(embeddings[trained])
        self._index.add(embeddings)
        self._faiss, self.lists = faiss, lists
        self.probes, self.recall = self._settle(rng, lists, wanted)
        self._index.nprobe = self.probes

    def search(
        self, z: ArrayLike, k: int, mask: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """About the k most similar rows, by falling similarity, then by rising row; see `ExactSearch.search`.

        Fewer than k come back where the lists that are gone through hold fewer. A small part of the map (``mask``) is
        searched exactly.
        """
        rows = len(self.embeddings)
        queries = check_query(z, self.embeddings.shape[1], k, mask, rows)
        if mask is not None and np.count_nonzero(mask) <= LARGE:
            return self._exact.search(z, k, mask)
        options = self._faiss.SearchParametersIVF(nprobe=self.probes)
        if mask is not None:
            selector = self._faiss.IDSelectorBitmap(np.packbits(mask, bitorder="little"))
            options = self._faiss.SearchParametersIVF(nprobe=self.probes, sel=selector)
        _, found = self._index.search(queries, min(k, rows), params=options)
        answers = [self._score(row[row >= 0], query) for row, query in zip(found, queries, strict=True)]
        if np.ndim(z) == 1:
            return answers[0]
        few = min(len(indices) for indices, _ in answers) if answers else 0
        indices = np.array([indices[:few] for indices, _ in answers], dtype=np.int64).reshape(len(answers), few)
        return indices, np.array([values[:few] for _, values in answers], dtype=np.float32).reshape(indices.shape)

    def _score(
        self, rows: NDArray[np.int64], query: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Similarities as exact search has them, to the last bit, and its order."""
        exact = (self.embeddings[rows].astype(np.float64) * query).sum(axis=1).astype(np.float32)
        order = np.lexsort((rows, -exact))
        return rows[order], exact[order]

    def _settle(self, rng: np.random.Generator, lists: int, wanted: float) -> tuple[int, float]:
        """How many lists to go through, and the recall then."""
        rows, dimension = self.embeddings.shape
        queries = self.embeddings[rng.integers(0, rows, _SAMPLE)].copy()
        queries += rng.normal(0, 0.2 / dimension**0.5, queries.shape).astype(np.float32)
        queries /= np.linalg.norm(queries, axis=1, keepdims=True).clip(1e-12)
        truth, _ = self._exact.search(queries, _K)
        probes = 1
        while True:
            self._index.nprobe = probes
            _, found = self._index.search(queries, min(_K, rows))
            hits = [len(set(a) & set(b)) for a, b in zip(truth.tolist(), found.tolist(), strict=True)]
            recall = sum(hits) / max(1, truth.size)
            if recall >= wanted or probes >= lists:
                return probes, recall
            probes = min(lists, probes * 2)


def _faiss() -> Any:
    try:
        import faiss
    except ImportError:
        raise MapError("expected faiss for an approximate search (got none: pip install 'semloc[search]')") from None
    return faiss
