"""Retrieval and classification figures against cases done by hand, and against scikit-learn."""

import math

import numpy as np
import pytest
from sklearn.metrics import average_precision_score, f1_score

from semloc_core.encoding.similarity import similarity_matrix
from semloc_core.errors import ConfigError
from semloc_core.metrics import precision_recall as metrics


def f32(rows: list[list[float]]) -> np.ndarray:
    return np.array(rows, dtype=np.float32)


def test_recall_ceiling_and_success_by_hand() -> None:
    similarity = f32([[0.9, 0.8, 0.1, 0.0], [0.1, 0.2, 0.9, 0.3], [0.5, 0.5, 0.5, 0.5]])
    positive = np.array([[1, 0, 1, 1], [1, 1, 0, 0], [0, 0, 0, 0]], dtype=bool)
    figures = metrics.retrieval(similarity, positive, ranks=(1, 2, 10))
    assert figures["recall@1"] == pytest.approx((1 / 3 + 0) / 2)
    assert figures["recall_ceiling@1"] == pytest.approx((1 / 3 + 1 / 2) / 2)
    assert figures["success@1"] == 0.5
    assert figures["recall@2"] == pytest.approx((1 / 3 + 0) / 2)
    assert figures["recall_ceiling@2"] == pytest.approx((2 / 3 + 1) / 2)
    assert figures["recall@10"] == figures["recall_ceiling@10"] == figures["success@10"] == 1.0
    assert figures["queries"] == 2  # the third query has no positive and is not counted


def test_retrieval_without_any_positive_is_nan_not_an_error() -> None:
    figures = metrics.retrieval(f32([[0.1, 0.2]]), np.zeros((1, 2), dtype=bool))
    assert figures["queries"] == 0
    assert math.isnan(figures["recall@1"])
    assert math.isnan(metrics.pr_auc(f32([[0.1]]), np.zeros((1, 1), dtype=bool)))


def test_ties_are_ranked_by_index() -> None:
    similarity = f32([[0.5, 0.9, 0.5, 0.9, 0.5]])
    assert metrics.top(similarity, 4).tolist() == [[1, 3, 0, 2]]
    assert metrics.top(np.zeros((1, 6), dtype=np.float32), 3).tolist() == [[0, 1, 2]]


def test_top_equals_a_full_stable_sort() -> None:
    rng = np.random.default_rng(0)
    similarity = rng.integers(0, 8, size=(40, 57)).astype(np.float32)
    expected = np.argsort(-similarity, axis=1, kind="stable")
    for n in (1, 10, 57, 80):
        assert (metrics.top(similarity, n) == expected[:, :n]).all()


def test_top_of_an_empty_map_is_empty() -> None:
    assert metrics.top(np.zeros((3, 0), dtype=np.float32), 5).shape == (3, 0)
    assert metrics.hits(np.zeros((3, 0), dtype=np.float32), np.zeros((3, 0), dtype=bool)).tolist() == [[0, 0, 0]] * 3


def test_equal_embeddings_stay_tied_after_the_product() -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(300, 37)).astype(np.float32)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    places = np.concatenate([rows, rows, rows[:7]])
    similarity = similarity_matrix(rows, places)
    assert (similarity[:, :300] == similarity[:, 300:600]).all()
    assert (similarity[:, :7] == similarity[:, 600:]).all()
    assert np.abs(similarity - rows @ places.T).max() < 2e-6


def test_pr_auc_and_f1_are_sklearns() -> None:
    rng = np.random.default_rng(2)
    positive = rng.random((30, 40)) < 0.1
    similarity = (rng.random((30, 40)) + 0.4 * positive).astype(np.float32)
    assert metrics.pr_auc(similarity, positive) == pytest.approx(
        average_precision_score(positive.ravel(), similarity.ravel())
    )
    assert metrics.f1_at(similarity, positive, 0.8) == pytest.approx(
        f1_score(positive.ravel(), similarity.ravel() >= 0.8)
    )


def test_threshold_is_the_best_of_all_thresholds() -> None:
    rng = np.random.default_rng(3)
    positive = rng.random((15, 12)) < 0.2
    similarity = np.round(rng.random((15, 12)) + 0.5 * positive, 2).astype(np.float32)
    fitted = metrics.fit_threshold(similarity, positive)
    scores = {float(t): metrics.f1_at(similarity, positive, float(t)) for t in np.unique(similarity)}
    assert metrics.f1_at(similarity, positive, fitted) == pytest.approx(max(scores.values()))


def test_threshold_separates_what_can_be_separated() -> None:
    similarity, positive = f32([[0.9, 0.1], [0.2, 0.8]]), np.eye(2, dtype=bool)
    assert metrics.fit_threshold(similarity, positive) == pytest.approx(0.8)
    assert metrics.f1_at(similarity, positive, 0.8) == 1.0
    assert metrics.f1_at(similarity, positive, 0.95) == 0.0


def test_threshold_needs_a_positive() -> None:
    with pytest.raises(ConfigError, match=r"expected at least one positive pair .*\(got none\)"):
        metrics.fit_threshold(f32([[0.1]]), np.zeros((1, 1), dtype=bool))


def test_bootstrap_interval_matches_the_normal_one_and_is_seeded() -> None:
    values = np.arange(400) % 4 == 0
    interval = metrics.bootstrap_interval(values, np.random.default_rng(0), resamples=4000)
    half = 1.96 * math.sqrt(0.25 * 0.75 / 400)
    assert interval == pytest.approx((0.25 - half, 0.25 + half), abs=0.006)
    assert interval == metrics.bootstrap_interval(values, np.random.default_rng(0), resamples=4000)
    assert metrics.bootstrap_interval(np.ones(5), np.random.default_rng(0)) == (1.0, 1.0)


def test_resampling_buildings_widens_the_interval() -> None:
    groups = np.repeat(np.arange(10), 50)
    values = groups % 2  # a building is right throughout or wrong throughout
    queries = metrics.bootstrap_interval(values, np.random.default_rng(0))
    buildings = metrics.bootstrap_interval(values, np.random.default_rng(0), groups=groups)
    assert buildings[0] < queries[0] - 0.1
    assert buildings[1] > queries[1] + 0.1


def test_mean_and_deviation_over_seeds() -> None:
    figures = metrics.mean_and_deviation([{"f1": 0.2}, {"f1": 0.4}])
    assert figures["f1"] == pytest.approx(0.3)
    assert figures["f1_std"] == pytest.approx(math.sqrt(0.02))
    assert metrics.mean_and_deviation([{"f1": 0.2}])["f1_std"] == 0.0
    with pytest.raises(ConfigError):
        metrics.mean_and_deviation([])
