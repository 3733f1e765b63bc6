"""The peer CLIPPER, written from its paper: breaks if its sets are not the densest, or its poses not the right ones."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from semloc_core.evaluate.online.clipper import ClipperConfig, affinities, densest, original_clipper, register_clipper
from semloc_core.map_merge import fit_transform


def turned(points: np.ndarray, yaw: float, shift: tuple[float, float, float]) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + shift


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi, -2.5])
def test_a_turned_and_shifted_set_is_laid_back_whatever_is_strange_in_it(yaw):
    rng = np.random.default_rng(3)
    mapped = np.concatenate([rng.uniform(-8, 8, (20, 2)), rng.uniform(0, 2, (20, 1))], axis=1)
    classes = rng.integers(0, 5, 20)
    seen = turned(mapped[:12], yaw, (30.0, -7.0, 1.0))
    strangers = turned(rng.uniform(-8, 8, (5, 3)), 0.0, (30.0, -7.0, 1.0))
    found = register_clipper(
        np.concatenate([seen, strangers]), np.concatenate([classes[:12], classes[:5]]), mapped, classes
    )
    assert found is not None
    assert {(i, j) for i, j in zip(found.seen.tolist(), found.mapped.tolist(), strict=True) if i < 12} == {
        (i, i) for i in range(12)
    }
    np.testing.assert_allclose(found.transform.apply(seen), mapped[:12], atol=0.25)
    assert np.cos(found.transform.yaw + yaw) > 0.999


def test_a_large_consistent_set_is_found_among_chance_ones_and_no_two_of_it_contradict_one_another():
    rng = np.random.default_rng(0)
    for _ in range(20):
        raw = np.triu(rng.uniform(0.3, 1.0, (60, 60)) * (rng.random((60, 60)) < 0.2), 1)
        planted = np.sort(rng.choice(60, 9, replace=False))
        raw[np.ix_(planted, planted)] = np.triu(rng.uniform(0.7, 1.0, (9, 9)), 1)
        affinity = raw + raw.T
        chosen, score = densest(affinity)
        inside = affinity[np.ix_(chosen, chosen)]
        assert (inside + np.eye(len(chosen)) > 0).all()
        assert set(chosen.tolist()) <= set(planted.tolist())
        assert len(chosen) >= 7
        assert 7.0 < score <= np.linalg.eigvalsh(affinity + np.eye(60)).max() + 1e-6


def test_pairs_are_as_consistent_as_their_distances_are_alike():
    first, second = np.array([[0.0, 2.0], [2.0, 0.0]]), np.array([[0.0, 2.4], [2.4, 0.0]])
    off = affinities(first, second, ClipperConfig(sigma_m=0.4, epsilon_m=0.8))
    np.testing.assert_allclose(off, np.exp(-0.5) * (1 - np.eye(2)))
    assert not affinities(first, first + 0.9 * (first > 0), ClipperConfig()).any(), "further off than epsilon"
    assert not affinities(first, second, ClipperConfig(mindist_m=2.1)).any(), "one is too near on one side"
    assert not affinities(np.zeros((2, 2)), second, ClipperConfig(mindist_m=0.0)).any(), "they share an object"


def test_fewer_than_two_consistent_pairs_are_no_pose():
    at = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    assert register_clipper(at, np.array([0, 1]), at, np.array([0, 2])) is None
    assert register_clipper(at, np.array([0, 1]), at * 3, np.array([0, 1])) is None
    assert register_clipper(at[:0], np.zeros(0, dtype=np.int64), at, np.array([0, 1])) is None


def test_the_fit_is_the_least_squares_one():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 3))
    found = fit_transform(points, turned(points, 0.7, (1.0, 2.0, 3.0)), np.ones(30))
    assert found.yaw == pytest.approx(0.7)
    np.testing.assert_allclose(found.translation, (1.0, 2.0, 3.0), atol=1e-9)


def test_the_original_is_asked_where_it_is_installed(monkeypatch):
    """Through its Python package's face, here answered by the one written from the paper."""
    asked = []

    class Solver:
        def __init__(self, invariant, params):
            self.config = ClipperConfig(
                sigma_m=invariant.sigma, epsilon_m=invariant.epsilon, mindist_m=invariant.mindist
            )

        def score_pairwise_consistency(self, seen, mapped, pairs):
            asked.append((seen.shape, mapped.shape, pairs.dtype))
            far = [
                np.linalg.norm((p[:, :, None] - p[:, None]), axis=0)
                for p in (seen[:, pairs[:, 0]], mapped[:, pairs[:, 1]])
            ]
            self.pairs, self.affinity = pairs, affinities(*far, self.config)

        def solve(self):
            self.chosen, self.score = densest(self.affinity, self.config)

        def get_selected_associations(self):
            return self.pairs[self.chosen]

        def get_solution(self):
            return self

    invariants = SimpleNamespace(EuclideanDistanceParams=SimpleNamespace, EuclideanDistance=lambda given: given)
    peer = SimpleNamespace(invariants=invariants, CLIPPER=Solver, Params=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "clipperpy", peer)
    by = original_clipper()
    assert by is not None
    rng = np.random.default_rng(3)
    mapped, classes = rng.uniform(-8, 8, (15, 3)), rng.integers(0, 4, 15)
    seen = turned(mapped[:9], 0.8, (3.0, 1.0, 0.0))
    config = ClipperConfig(sigma_m=0.3)
    found, own = (one(seen, classes[:9], mapped, classes, config) for one in (by, register_clipper))
    assert asked == [((3, 9), (3, 15), np.dtype(np.int32))]
    assert set(zip(found.seen.tolist(), found.mapped.tolist(), strict=True)) == set(
        zip(own.seen.tolist(), own.mapped.tolist(), strict=True)
    )
    assert found.score == own.score
    assert by(seen[:1], classes[:1], mapped, classes + 9, config) is None
    monkeypatch.setitem(sys.modules, "clipperpy", None)
    assert original_clipper() is None
