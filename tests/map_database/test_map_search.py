"""Exact search: against a plain reference, with ties, masks and the number of BLAS threads."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from semloc_core.errors import MapError
from semloc_core.map_database.search.exact import ExactSearch, kth_largest


def unit_rows(rng: np.random.Generator, rows: int, dimension: int = 32) -> NDArray[np.float32]:
    values = rng.standard_normal((rows, dimension)).astype(np.float32)
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def reference(
    embeddings: NDArray[np.float32], z: NDArray[np.float32], k: int, mask: NDArray[np.bool_] | None = None
) -> tuple[list[int], list[float]]:
    """Every similarity in float64, sorted in plain Python."""
    exact = (embeddings.astype(np.float64) * z).sum(axis=1).astype(np.float32)
    rows = [i for i in range(len(embeddings)) if mask is None or mask[i]]
    best = sorted(rows, key=lambda i: (-exact[i], i))[:k]
    return best, exact[best].tolist()


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.sampled_from([0, 1, 2, 9, 300, 1023, 1024, 5000, 20000]),
    distinct=st.sampled_from([1, 3, 50, 10**6]),
    k=st.sampled_from([1, 2, 10, 100, 6000]),
    kept=st.sampled_from([None, 0.0, 0.001, 0.3, 1.0]),
)
def test_equals_sorting_all_similarities(seed: int, rows: int, distinct: int, k: int, kept: float | None) -> None:
    rng = np.random.default_rng(seed)
    some = unit_rows(rng, min(distinct, max(rows, 1)), 8)
    embeddings = np.ascontiguousarray(some[rng.integers(len(some), size=rows)]).reshape(rows, 8)
    z = unit_rows(rng, 1, 8)[0]
    mask = None if kept is None else rng.random(rows) < kept
    indices, similarities = ExactSearch(embeddings).search(z, k, mask)
    assert (indices.tolist(), similarities.tolist()) == reference(embeddings, z, k, mask)
    assert indices.dtype == np.int64
    assert similarities.dtype == np.float32


def test_batch_of_many_equals_batches_of_one() -> None:
    rng = np.random.default_rng(1)
    search = ExactSearch(unit_rows(rng, 4003))
    queries = unit_rows(rng, 37)
    indices, similarities = search.search(queries, 7)
    for row, query in enumerate(queries):
        one, one_similarity = search.search(query, 7)
        np.testing.assert_array_equal(one, indices[row])
        np.testing.assert_array_equal(one_similarity, similarities[row])


def test_equal_embeddings_tie_by_row_wherever_they_lie() -> None:
    """BLAS rounds a row's product differently in the body and in the tail of a block; the answer must not."""
    rng = np.random.default_rng(2)
    embeddings = unit_rows(rng, 10_007)
    twins = np.array([0, 3, 1024, 5001, 9999, 10_003, 10_006])
    embeddings[twins] = embeddings[17]
    indices, similarities = ExactSearch(embeddings).search(embeddings[17], 8)
    assert indices.tolist() == sorted([17, *twins.tolist()])
    assert len(set(similarities.tolist())) == 1


@pytest.mark.parametrize("rows", [37, 1278, 70_001])
def test_equal_embeddings_are_equally_similar_also_beyond_the_best(rows: int) -> None:
    """What sums over a map goes by, and verification by layout takes candidates from, must not hang on a row either."""
    rng = np.random.default_rng(3)
    some = unit_rows(rng, 9, 33)
    which = rng.integers(len(some), size=rows)
    found, similarities, everywhere = ExactSearch(np.ascontiguousarray(some[which])).everywhere(some[4], 5)
    assert all(len(np.unique(everywhere[which == i])) <= 1 for i in range(len(some)))
    assert everywhere[found].tolist() == similarities.tolist()
    assert np.abs(everywhere - (some[which].astype(np.float64) @ some[4])).max() < 1e-6


def test_a_zero_query_ties_everywhere() -> None:
    indices, similarities = ExactSearch(unit_rows(np.random.default_rng(3), 50_000)).search(np.zeros(32), 5)
    assert indices.tolist() == [0, 1, 2, 3, 4]
    assert not similarities.any()


def test_k_above_the_number_of_rows_returns_all() -> None:
    indices, _ = ExactSearch(unit_rows(np.random.default_rng(4), 5)).search(np.ones(32), 99)
    assert sorted(indices.tolist()) == [0, 1, 2, 3, 4]


def test_an_empty_map_answers_with_nothing() -> None:
    search = ExactSearch(np.zeros((0, 32), dtype=np.float32))
    assert search.search(np.ones(32), 3)[0].shape == (0,)
    assert search.search(np.ones((4, 32)), 3)[1].shape == (4, 0)


def test_no_query_at_all_gives_an_empty_batch() -> None:
    indices, _ = ExactSearch(unit_rows(np.random.default_rng(5), 5)).search(np.zeros((0, 32)), 3)
    assert indices.shape == (0, 3)


SCRIPT = """
import hashlib, sys
import numpy as np
from semloc_core.map_database.search.exact import ExactSearch
rng = np.random.default_rng(6)
embeddings = rng.standard_normal((200_003, 32)).astype(np.float32)
embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
embeddings[100_000:] = embeddings[:100_003]
digest = hashlib.sha256()
for z in embeddings[::20_000]:
    for array in ExactSearch(embeddings).search(z, 20):
        digest.update(array.tobytes())
for array in ExactSearch(embeddings).search(embeddings[:9], 20):
    digest.update(array.tobytes())
sys.stdout.write(digest.hexdigest())
"""


def test_answers_do_not_depend_on_the_number_of_threads() -> None:
    answers = set()
    for threads in ("1", "2", "4"):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        environment = os.environ | dict.fromkeys(names, threads)
        run = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
        )
        answers.add(run.stdout)
    assert len(answers) == 1


@pytest.mark.parametrize(
    "embeddings",
    [
        np.full((3, 4), np.nan, dtype=np.float32),
        np.full((3, 4), np.inf, dtype=np.float32),
        np.full((3, 4), 1e20, dtype=np.float32),
        np.zeros((3, 4), dtype=np.float64),
        np.zeros(4, dtype=np.float32),
        np.zeros((4, 3), dtype=np.float32).T,
    ],
)
def test_refuses_embeddings_that_it_can_not_rank(embeddings: NDArray[np.float32]) -> None:
    with pytest.raises(MapError, match=r"^expected .* \(got [^\n]*\)$"):
        ExactSearch(embeddings)


@pytest.mark.parametrize(
    ("z", "k", "mask"),
    [
        (np.full(32, np.nan), 1, None),
        (np.full((2, 32), np.inf), 1, None),
        (np.full(32, 1e30), 1, None),
        (np.zeros(31), 1, None),
        (np.zeros((1, 1, 32)), 1, None),
        (np.zeros(32), 0, None),
        (np.zeros(32), 1, np.ones(4, dtype=np.bool_)),
        (np.zeros(32), 1, np.ones(5, dtype=np.int64)),
    ],
)
def test_refuses_a_query_without_an_answer(z: NDArray[np.float64], k: int, mask: NDArray[np.bool_] | None) -> None:
    search = ExactSearch(unit_rows(np.random.default_rng(7), 5))
    with pytest.raises(MapError, match=r"^expected .* \(got [^\n]*\)$"):
        search.search(z, k, mask)


@pytest.mark.parametrize("rows", [1, 300, 70_000])
def test_one_pass_finds_what_a_search_finds_and_knows_all_the_rest(rows: int) -> None:
    """Also above the size from which a copy by columns is used."""
    rng = np.random.default_rng(0)
    embeddings = rng.standard_normal((rows, 8)).astype(np.float32)
    search, z = ExactSearch(embeddings), rng.standard_normal(8).astype(np.float32)
    best, exact, everywhere = search.everywhere(z, 20)
    found, similarities = search.search(z, 20)
    np.testing.assert_array_equal(best, found)
    np.testing.assert_array_equal(exact, similarities)
    np.testing.assert_array_equal(everywhere[best], exact)
    np.testing.assert_allclose(everywhere, embeddings.astype(np.float64) @ z, atol=1e-5)
    for wrong, k in ((np.full(8, np.nan, np.float32), 3), (z[:4], 3), (z.astype(np.float64), 3), (z, 0)):
        with pytest.raises(MapError, match=r"^expected k of at least 1 .* \(got "):
            search.everywhere(wrong, k)


@pytest.mark.parametrize(("n", "k"), [(10, 1), (100, 9), (64 * 50, 9), (64 * 400 + 7, 400), (30_000, 5)])
def test_the_kth_largest_of_many_is_that_of_all_sorted(n, k):
    """It is found without sorting, by blocks: else a large map would try others than a small one."""
    values = np.round(np.random.default_rng(n).normal(size=n), 2).astype(np.float32)
    assert kth_largest(values, k) == np.sort(values)[-k]
