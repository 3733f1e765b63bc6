"""Approximate search: what it finds is scored and ordered as exact search does, and it finds nearly all."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from semloc_core.errors import MapError
from semloc_core.map_database.search import inverted
from semloc_core.map_database.search.exact import ExactSearch
from semloc_core.map_database.search.inverted import InvertedSearch

pytest.importorskip("faiss", reason="faiss is not installed: approximate search was NOT tested")


def crowd(rows: int, seed: int = 0) -> NDArray[np.float32]:
    """Unit vectors in groups, as places of like rooms are."""
    rng = np.random.default_rng(seed)
    middles = rng.standard_normal((rows // 40 + 1, 16))
    values = middles[rng.integers(0, len(middles), rows)] + 0.4 * rng.standard_normal((rows, 16))
    unit: NDArray[np.float32] = (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)
    return unit


def near(embeddings: NDArray[np.float32], n: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(9)
    found: NDArray[np.float32] = embeddings[rng.integers(0, len(embeddings), n)]
    return found + rng.normal(0, 0.02, found.shape).astype(np.float32)


def test_it_finds_nearly_all_and_says_how_much() -> None:
    embeddings = crowd(20_000)
    search, exact = InvertedSearch(embeddings, wanted=0.95), ExactSearch(embeddings)
    assert search.recall >= 0.95
    assert search.probes < 20_000**0.5  # else it is exact search by another name
    queries = near(embeddings, 100)
    found, truth = search.search(queries, 10)[0], exact.search(queries, 10)[0]
    hits = np.mean([len(set(a) & set(b)) / 10 for a, b in zip(found.tolist(), truth.tolist(), strict=True)])
    assert hits >= 0.9


def test_what_it_finds_is_scored_and_ordered_as_by_exact_search() -> None:
    embeddings = np.repeat(crowd(3_000), 2, axis=0)  # every similarity comes twice
    search, exact = InvertedSearch(embeddings), ExactSearch(embeddings)
    for query in near(embeddings, 20):
        rows, values = search.search(query, 40)
        everywhere = exact.everywhere(query, len(embeddings))[2]
        assert values.tolist() == everywhere[rows].tolist()
        assert rows.tolist() == sorted(rows.tolist(), key=lambda row: (-everywhere[row], row))
        assert rows.dtype == np.int64
        assert values.dtype == np.float32


def test_one_query_or_many_and_the_same_again() -> None:
    embeddings = crowd(5_000)
    search, again = InvertedSearch(embeddings), InvertedSearch(embeddings.copy())
    queries = near(embeddings, 7)
    rows, values = search.search(queries, 5)
    for i, query in enumerate(queries):
        assert rows[i].tolist() == search.search(query, 5)[0].tolist()
    assert (rows.tolist(), values.tolist()) == tuple(x.tolist() for x in again.search(queries, 5))


def test_only_what_the_mask_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    embeddings = crowd(5_000)
    search, exact = InvertedSearch(embeddings), ExactSearch(embeddings)
    mask = np.arange(5_000) % 3 == 1
    query = near(embeddings, 1)[0]
    assert search.search(query, 9, mask)[0].tolist() == exact.search(query, 9, mask)[0].tolist()
    monkeypatch.setattr(inverted, "LARGE", 100)  # now the mask leaves more than is searched exactly
    rows, _ = search.search(query, 9, mask)
    assert mask[rows].all()
    assert len(set(rows.tolist()) & set(exact.search(query, 9, mask)[0].tolist())) >= 6


@pytest.mark.parametrize("rows", [1, 2, 30])
def test_hardly_any_places(rows: int) -> None:
    embeddings = crowd(rows)
    found, values = InvertedSearch(embeddings).search(embeddings[0], 5)
    assert found[0] == 0
    assert len(found) == len(values) <= min(5, rows)


@pytest.mark.parametrize("query", [np.zeros(3, dtype=np.float32), np.full(16, np.nan, dtype=np.float32)])
def test_a_query_that_does_not_fit_is_refused(query: NDArray[np.float32]) -> None:
    with pytest.raises(MapError, match="expected"):
        InvertedSearch(crowd(50)).search(query, 1)


def test_without_faiss_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "faiss", None)
    with pytest.raises(MapError, match=r"semloc\[search\]"):
        InvertedSearch(crowd(50))
