import math

import numpy as np
import pytest
import torch
from buildings import LABELS, building

from semloc_core.encoding.encoder import build_encoder
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.split import split_places
from semloc_core.training.validation import _log_loss, fit_temperature, honest_temperature, judge
from semloc_core.training.views.variants import VariantMaker, VariantPool, pair_masks

RINGS = build_encoder("rings", None, len(LABELS))


def maker(perturb: PerturbConfig | None = None, n: int = 1) -> VariantMaker:
    graphs = [building(seed, name=str(seed)) for seed in range(n)]
    splits = [split_places(graph, 0) for graph in graphs]
    return VariantMaker(graphs, splits, LABELS, RINGS.extraction, perturb or PerturbConfig(), (0, 1))


def test_pairs_of_two_buildings_are_never_positive():
    here = np.zeros((2, 3))
    positive, ignore = pair_masks([(0, here), (1, here)], [(0, here[:1]), (1, here)], 4.0)
    assert positive.tolist() == [[True, False, False]] * 2 + [[False, True, True]] * 2
    assert ignore is None


def test_pairs_just_beyond_the_radius_are_ignored_on_demand():
    places = np.array([[3.0, 0, 0], [5.0, 0, 0], [9.0, 0, 0]])
    positive, ignore = pair_masks([(0, np.zeros((1, 3)))], [(0, places), (1, places[1:2])], 4.0, 8.0)
    assert positive.tolist() == [[True, False, False, False]]
    assert ignore.tolist() == [[False, True, False, False]]


def test_a_variant_is_a_function_of_seed_building_and_number():
    one, two = maker().make(0, 5), maker().make(0, 5)
    assert torch.equal(one.batch.edge_length, two.batch.edge_length)
    other = maker().make(0, 6)
    assert one.batch.edge_index.shape != other.batch.edge_index.shape or not torch.equal(
        one.batch.edge_length, other.batch.edge_length
    )


def distinct(variants):
    """Those that are not one object; they are held, since an `id` is used again for what comes later."""
    held = []
    for variant in variants:
        if not any(variant is other for other in held):
            held.append(variant)
    return held


def test_the_pool_draws_two_different_variants_from_a_window_that_moves():
    pool = VariantPool(maker(), size=3, refresh_steps=10)
    seen = distinct(v for k in range(30) for v in pool.draw(0, 0, np.random.default_rng(k)))
    assert len(seen) == 3
    a, b = pool.draw(0, 0, np.random.default_rng(0))
    assert a is not b
    fresh = distinct(v for k in range(30) for v in pool.draw(0, 10, np.random.default_rng(k)))
    assert sum(any(v is old for old in seen) for v in fresh) == 2


def test_perfect_embeddings_score_one():
    """Unperturbed variants, a radius so small that a place is positive with itself alone."""
    still = maker(PerturbConfig(mobility_scale=0.0))
    pair = [(still.make(0, 0), still.make(0, 1))]
    found = judge(RINGS, pair, "validation", TrainConfig(positive_radius_m=0.01))
    assert found.pr_auc > 0.9
    assert found.loss > 0


def toy(n: int = 60, m: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Similarities with noise; column q % m is right; columns one apart are near."""
    rng = np.random.default_rng(0)
    right_column = np.arange(n) % m
    similarity = np.clip(rng.normal(0.0, 0.2, (n, m)), -1, 1)
    similarity[np.arange(n), right_column] += 0.45
    best = similarity.argmax(axis=1)
    near = np.abs(np.arange(m)[None, :] - best[:, None]) <= 1
    return similarity, near, np.abs(best - right_column) <= 1


def test_the_fitted_temperature_is_the_minimum():
    similarity, near, right = toy()
    assert 0 < right.sum() < len(right)
    fitted = honest_temperature(similarity, near, right)
    everywhere = [_log_loss(similarity, near, right, t) for t in np.geomspace(1e-4, 10, 2000)]
    assert _log_loss(similarity, near, right, fitted) <= min(everywhere) + 1e-6


def test_the_probabilities_are_right_as_often_as_they_say():
    """On average: too small a temperature would claim certainty, too large a one would claim nothing."""
    similarity, near, right = toy(400)
    logits = similarity / honest_temperature(similarity, near, right)
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    claimed = (weights * near).sum(axis=1) / weights.sum(axis=1)
    assert claimed.mean() == pytest.approx(right.mean(), abs=0.1)


def test_always_right_does_not_claim_more_than_was_seen():
    """Platt's targets: ten right answers out of ten are no proof of certainty."""
    similarity, near, right = toy(10)
    cautious = honest_temperature(similarity, near, np.ones_like(right))
    assert cautious > 1e-3


def test_a_temperature_is_fitted_where_no_validation_place_has_a_positive():
    far = maker(n=1)
    assert 0 < fit_temperature(RINGS, [(far.make(0, 0), far.make(0, 1))], 1e-6) <= 10


def test_log_loss_closed_form():
    similarity = np.array([[1.0, 0.5, 0.0], [0.2, 0.9, 0.1]])
    near, right = np.array([[True, True, False], [False, True, False]]), np.array([True, False])
    weights = np.exp(similarity / 0.5)
    p = (weights * near).sum(axis=1) / weights.sum(axis=1)
    # One right and one wrong: targets (1 + 1) / (1 + 2) and 1 / (1 + 2).
    expected = -np.mean(
        [2 / 3 * math.log(p[0]) + 1 / 3 * math.log(1 - p[0]), 1 / 3 * math.log(p[1]) + 2 / 3 * math.log(1 - p[1])]
    )
    assert _log_loss(similarity, near, right, 0.5) == pytest.approx(expected)
