import math

import numpy as np
import pytest
import torch
from buildings import LABELS, building

from semloc_core.encoder import build_encoder
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.split import split_places
from semloc_core.training.validation import _surprise, fit_temperature, judge, likeliest_temperature
from semloc_core.training.variants import VariantMaker, VariantPool, pair_masks

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


def test_the_pool_draws_two_different_variants_from_a_window_that_moves():
    pool = VariantPool(maker(), size=3, refresh_steps=10)
    seen = {id(v) for k in range(30) for v in pool.draw(0, 0, np.random.default_rng(k))}
    assert len(seen) == 3
    a, b = pool.draw(0, 0, np.random.default_rng(0))
    assert a is not b
    fresh = {id(v) for k in range(30) for v in pool.draw(0, 10, np.random.default_rng(k))}
    assert len(fresh & seen) == 2


def test_perfect_embeddings_score_one():
    """Unperturbed variants, a radius so small that a place is positive with itself alone."""
    still = maker(PerturbConfig(mobility_scale=0.0))
    pair = [(still.make(0, 0), still.make(0, 1))]
    found = judge(RINGS, pair, "validation", TrainConfig(positive_radius_m=0.01))
    assert found.pr_auc > 0.9
    assert found.loss > 0


def test_the_fitted_temperature_is_the_minimum():
    rng = np.random.default_rng(0)
    positive = rng.random((40, 60)) < 0.1
    similarity = np.clip(0.3 * positive + rng.normal(0.0, 0.2, positive.shape), -1, 1)
    fitted = likeliest_temperature(similarity, positive)
    judged = positive.any(1)
    everywhere = [_surprise(similarity[judged], positive[judged], t) for t in np.geomspace(1e-4, 10, 2000)]
    assert _surprise(similarity[judged], positive[judged], fitted) <= min(everywhere) + 1e-6


def test_no_positive_leaves_the_temperature_at_one():
    assert likeliest_temperature(np.zeros((2, 3)), np.zeros((2, 3), dtype=bool)) == 1.0


def test_a_temperature_is_fitted_where_no_validation_place_has_a_positive():
    far = maker(n=1)
    assert 0 < fit_temperature(RINGS, [(far.make(0, 0), far.make(0, 1))], 1e-6) <= 10


def test_surprise_closed_form():
    similarity = np.array([[1.0, 0.5, 0.0]])
    positive = np.array([[True, True, False]])
    weights = np.exp(similarity / 0.5)
    expected = -math.log((weights[0, 0] + weights[0, 1]) / weights.sum())
    assert _surprise(similarity, positive, 0.5) == pytest.approx(expected)
