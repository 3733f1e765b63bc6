"""Shapley values: axioms on games known by hand, exact against sampled, agreement with Captum."""

import itertools
import math

import numpy as np
import pytest
import torch
from query_cases import any_encoder, encoder_query, node_shapley, paper_encoder, toy_query

from semloc_core.errors import ConfigError
from semloc_core.explain import class_scores
from semloc_core.explain.explainers.coalitions import all_coalitions, exact_values, sampled_values
from semloc_core.explain.explainers.shapley import class_shapley, class_values, shapley_sampling

CLASSES = [0, 1, 1, 2, 3, 0, 2]
OTHER = [0, 1, 2, 2, 3]


def gloves(present: np.ndarray) -> np.ndarray:
    """Player 0 has a left glove, 1 and 2 a right one, 3 nothing; a pair is worth 1. Values 2/3, 1/6, 1/6, 0."""
    return (present[:, 0] & (present[:, 1] | present[:, 2])).astype(float)


def test_glove_game_in_closed_form() -> None:
    found = exact_values(gloves, 4)
    np.testing.assert_allclose(found.values, [2 / 3, 1 / 6, 1 / 6, 0], atol=1e-12)
    assert found.standard_error is None
    assert found.gap == pytest.approx(0, abs=1e-12)


def test_exact_values_are_the_mean_over_all_orders() -> None:
    """The definition, taken literally, on a random game of five."""
    table = np.random.default_rng(0).normal(size=32)

    def game(present: np.ndarray) -> np.ndarray:
        return table[present @ (1 << np.arange(5))]

    want = np.zeros(5)
    for order in itertools.permutations(range(5)):
        joined = 0
        for player in order:
            want[player] += (table[joined | 1 << player] - table[joined]) / math.factorial(5)
            joined |= 1 << player
    np.testing.assert_allclose(exact_values(game, 5).values, want, atol=1e-12)


def test_coalitions_are_each_there_once() -> None:
    present = all_coalitions(4)
    assert present.shape == (16, 4)
    assert len({tuple(row) for row in present.tolist()}) == 16
    assert not present[0].any()
    assert present[-1].all()
    assert exact_values(lambda p: np.zeros(len(p)), 0).values.shape == (0,)


def test_sampling_is_unbiased_and_knows_its_error() -> None:
    """Over many seeds the error in units of its standard error must be about standard normal."""
    table = np.random.default_rng(1).normal(size=64)

    def game(present: np.ndarray) -> np.ndarray:
        return table[present @ (1 << np.arange(6))]

    exact = exact_values(game, 6).values
    z = []
    for seed in range(200):
        found = sampled_values(game, 6, 50, np.random.default_rng(seed))
        assert found.gap == pytest.approx(0, abs=1e-12)  # efficiency holds order by order
        z.append((found.values - exact) / found.standard_error)
    assert abs(np.mean(z)) < 0.1
    assert 0.9 < np.std(z) < 1.15


def test_dummy_gets_nothing_and_additive_games_have_no_error() -> None:
    worth = np.array([1.0, -2.0, 0.0, 0.5])
    found = sampled_values(lambda p: p @ worth, 4, 10, np.random.default_rng(0))
    np.testing.assert_allclose(found.values, worth, atol=1e-12)
    np.testing.assert_allclose(found.standard_error, 0, atol=1e-12)


@pytest.mark.parametrize("name", ["paper", "rings", "bag_of_words"])
def test_efficiency_on_encoders(name: str) -> None:
    """Node, class and sampled values all sum to what the objects together bring."""
    query = encoder_query(any_encoder(name), CLASSES, OTHER)
    ends = query.of_objects(np.array([[False] * 7, [True] * 7]))
    rng = np.random.default_rng(0)
    for found in (node_shapley(query), class_shapley(query, rng), shapley_sampling(query, rng)):
        assert found.scores.sum() == pytest.approx(ends[1] - ends[0], abs=1e-6), found.method
        assert found.completeness_gap == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", ["paper", "rings"])
def test_sampling_agrees_with_exact_on_encoders(name: str) -> None:
    query = encoder_query(any_encoder(name), CLASSES, OTHER)
    exact = node_shapley(query).scores
    found = shapley_sampling(query, np.random.default_rng(5), permutations=400)
    assert (np.abs(found.scores - exact) <= 4 * found.standard_error + 1e-6).all()


def test_symmetry_on_the_encoder() -> None:
    query = encoder_query(paper_encoder(), [1, 0, 2, 1, 0, 2, 3], OTHER)  # o0 and o3 are interchangeable
    score = dict(zip(query.ids, node_shapley(query).scores.tolist(), strict=True))
    assert score["o0"] == pytest.approx(score["o3"], abs=1e-6)
    assert score["o0"] != pytest.approx(score["o6"], abs=1e-4)


def test_class_values_are_those_of_the_game_of_classes() -> None:
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    names, players = query.class_players
    want = exact_values(lambda present: query.of_objects(present[:, players]), len(names)).values
    rows = class_scores(class_shapley(query, np.random.default_rng(0)))
    assert {row.class_: row.score for row in rows} == pytest.approx(dict(zip(names, want, strict=True)))
    assert {row.class_: row.instances for row in rows} == {
        "class_0": 2,
        "class_1": 2,
        "class_2": 2,
        "class_3": 1,
    }


def test_many_classes_are_sampled() -> None:
    worth = torch.arange(14.0)
    query = toy_query(
        lambda x, keep: (worth * keep).sum() + keep[0] * keep[1] * 3.0,
        torch.eye(14),
        [f"c{i:02d}" for i in range(14)],
    )
    found = class_values(query, np.random.default_rng(0), permutations=300)
    assert found.standard_error is not None
    assert (np.abs(found.values - [1.5, 2.5, *range(2, 14)]) <= 4 * found.standard_error + 1e-9).all()


def test_seeded() -> None:
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    first, again, other = (shapley_sampling(query, np.random.default_rng(seed)).scores for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_agrees_with_captum() -> None:
    """Captum blanks features where this library removes nodes: the same game, played by both."""
    attr = pytest.importorskip("captum.attr")
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    x = query.features[None]

    def blanked(present: np.ndarray) -> np.ndarray:
        features = x.repeat(len(present), 1, 1)
        features[:, query.rows] *= torch.from_numpy(present)[:, :, None]
        with torch.no_grad():
            return query.function(features, None).double().numpy()

    mask = torch.full(x.shape, 7)  # places together, and without features: a dummy
    mask[0, query.rows] = torch.arange(7)[:, None]
    torch.manual_seed(0)
    theirs = attr.ShapleyValueSampling(lambda f: query.function(f.detach(), None)).attribute(
        x, feature_mask=mask, n_samples=50
    )
    per_node = theirs[0, query.rows, 0].numpy()  # Captum writes a player's value to each of its features
    ours = sampled_values(blanked, 7, 300, np.random.default_rng(0))
    exact = exact_values(blanked, 7).values
    assert (np.abs(ours.values - exact) <= 4 * ours.standard_error + 1e-6).all()
    theirs_error = ours.standard_error * math.sqrt(300 / 50)
    assert (np.abs(per_node - exact) <= 4 * theirs_error + 1e-6).all()


def test_refusals() -> None:
    with pytest.raises(ConfigError, match="at most 20 players"):
        exact_values(gloves, 21)
    with pytest.raises(ConfigError, match="at least 2 permutations"):
        sampled_values(gloves, 4, 1, np.random.default_rng(0))
