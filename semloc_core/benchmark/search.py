"""Exact search beside faiss's, where it is installed (``semloc[search]``), and approximate search with its recall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semloc_core.benchmark.case import BenchCase
from semloc_core.benchmark.timing import Contender, by_turns
from semloc_core.map_database import ExactSearch, InvertedSearch
from semloc_core.metrics import Progress, Row, no_progress

SIZES = (10_000, 100_000, 1_000_000, 4_000_000)
K = 10
QUERIES = 256


def bench_search(
    case: BenchCase, sizes: Sequence[int] = SIZES, repeats: int = 50, progress: Progress = no_progress
) -> list[Row]:
    """Time a search for the 10 most similar of many embeddings of 32 floats, one query at a time, one thread.

    Args:
        case: gives the embeddings.
        sizes: of the maps, places.
        repeats: queries timed.
        progress: told of every size.

    Returns:
        Rows of semloc's exact search, the same with similarities to all places besides, faiss's exact, and the
        approximate search of large maps (`semloc_core.map_database.search.inverted`), the last with ``recall@10``.

    """
    rows: list[Row] = []
    for number, size in enumerate(sizes):
        progress(number, len(sizes), f"search among {size}")
        rows += _one_size(case.map_of(size).embeddings, repeats, progress)
    return rows


def _one_size(embeddings: NDArray[np.float32], repeats: int, progress: Progress) -> list[Row]:
    scope = f"10 nearest of {len(embeddings):,}"
    rng = np.random.default_rng(1)
    queries = embeddings[rng.integers(0, len(embeddings), QUERIES)]
    queries = queries + rng.normal(0, 0.02, queries.shape).astype(np.float32)
    search, turn = ExactSearch(embeddings), iter(range(10**9))

    def query() -> NDArray[np.float32]:
        one: NDArray[np.float32] = queries[next(turn) % QUERIES]
        return one

    contenders = [
        Contender(scope, "semloc, exact", lambda: search.search(query(), K)),
        Contender(scope, "semloc, exact, all similarities too", lambda: search.everywhere(query(), K)),
    ]
    recall = None
    faiss = _faiss()
    if faiss is not None:
        flat = faiss.IndexFlatIP(embeddings.shape[1])
        flat.add(embeddings)
        lists = InvertedSearch(embeddings)
        truth, found = flat.search(queries, K)[1], lists.search(queries, K)[0]
        recall = float(np.mean([len(set(a) & set(b)) / K for a, b in zip(truth.tolist(), found.tolist(), strict=True)]))
        contenders += [
            Contender(scope, "faiss, exact", lambda: flat.search(query()[None], K)),
            Contender(scope, f"semloc, {lists.probes} of {lists.lists} lists", lambda: lists.search(query(), K)),
        ]
    rows = by_turns(contenders, repeats, progress)
    if recall is not None:
        rows[-1]["recall@10"] = recall
    return rows


def _faiss() -> Any:
    try:
        import faiss
    except ImportError:
        return None
    faiss.omp_set_num_threads(1)
    return faiss
