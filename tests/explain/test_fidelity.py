"""Fidelity against hand-worked figures, its edge cases, and controls that it must tell from the real thing."""

import numpy as np
import pytest
import torch
from query_cases import any_encoder, encoder_query, node_shapley, paper_encoder, toy_query

from semloc_core.errors import ConfigError
from semloc_core.explain.explainers.by_name import EXPLAINERS, explain
from semloc_core.explain.explainers.random_baseline import inverted, random_scores
from semloc_core.explain.fidelity import (
    BUDGETS,
    budget_count,
    characterisation,
    fidelity_curves,
    own_fidelity,
    ranking,
)

CLASSES = [0, 1, 1, 2, 3, 0, 2]
OTHER = [0, 1, 2, 2, 3]
WORTH = torch.tensor([0.4, 0.3, 0.1, 0.0])


def additive(x: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
    """Similarity that is a sum of what each object is worth."""
    return (WORTH * keep).sum()


def test_by_hand() -> None:
    query = toy_query(additive, torch.eye(4), ["a", "b", "c", "d"])
    scores = query.scores("worth", WORTH.double().numpy())
    (curve,) = fidelity_curves(query, [scores], [0.25, 0.5, 1.0])
    np.testing.assert_allclose(curve.necessity, [0.2, 0.35, 0.4], atol=1e-6)  # half of what is dropped
    np.testing.assert_allclose(curve.sufficiency, [0.2, 0.05, 0.0], atol=1e-6)
    np.testing.assert_allclose(
        curve.characterisation,
        [1 / (0.5 / 0.2 + 0.5 / 0.8), 1 / (0.5 / 0.35 + 0.5 / 0.95), 1 / (0.5 / 0.4 + 0.5)],
        atol=1e-6,
    )


def test_budgets_count_objects_and_round_up() -> None:
    assert [budget_count(rho, 10) for rho in (0, 0.01, 0.1, 0.3, 0.7, 0.71, 1)] == [0, 1, 1, 3, 7, 8, 10]
    assert budget_count(0.3, 0) == 0
    assert all(budget_count(k / n, n) == k for n in range(1, 60) for k in range(n + 1))


def test_zero_denominators_give_zero_not_nan() -> None:
    zero, one, half = np.array(0.0), np.array(1.0), np.array(0.5)
    assert characterisation(zero, zero) == 0  # nothing was necessary
    assert characterisation(one, one) == 0  # nothing was sufficient
    assert characterisation(zero, one) == 0
    assert characterisation(one, zero) == 1
    assert characterisation(zero, half, 0.0, 1.0) == 0.5  # necessity has no weight, so its zero has no say
    assert characterisation(half, one, 1.0, 0.0) == 0.5


def test_the_weights_are_the_papers() -> None:
    necessity, sufficiency = np.array([0.2, 0.6]), np.array([0.1, 0.5])
    np.testing.assert_allclose(
        characterisation(necessity, sufficiency, 0.3, 0.7), 1 / (0.3 / necessity + 0.7 / (1 - sufficiency))
    )
    for weights in ((0.5, 0.6), (-0.5, 1.5)):
        with pytest.raises(ConfigError, match="sum to 1"):
            characterisation(necessity, sufficiency, *weights)


@pytest.mark.parametrize("name", ["paper", "rings", "bag_of_words", "histogram"])
def test_every_explainer_on_every_kind_of_encoder(name: str) -> None:
    """At ρ = 1 dropping leaves no object and keeping leaves all, whoever ranked; all figures stay in [0, 1]."""
    query = encoder_query(any_encoder(name), CLASSES, OTHER)
    rng = np.random.default_rng(0)
    curves = fidelity_curves(query, [explain(query, method, rng) for method in EXPLAINERS], (0.0, *BUDGETS))
    empty = query.of_objects(np.zeros((1, 7), dtype=bool))[0]
    for curve in curves:
        assert curve.necessity[0] == pytest.approx(0, abs=1e-6)
        assert curve.necessity[-1] == pytest.approx(abs(empty - query.full) / 2, abs=1e-6)
        assert curve.sufficiency[-1] == pytest.approx(0, abs=1e-6)
        for figure in (curve.necessity, curve.sufficiency, curve.characterisation):
            assert ((figure >= 0) & (figure <= 1)).all()


def test_one_at_a_time_is_the_same() -> None:
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    scores = [node_shapley(query), random_scores(query, np.random.default_rng(1))]
    together = fidelity_curves(query, scores)
    for of, curve in zip(scores, together, strict=True):
        for i, budget in enumerate(BUDGETS):
            single = own_fidelity(query, of, budget)
            assert single.necessity == pytest.approx(curve.necessity[i], abs=1e-6)
            assert single.sufficiency == pytest.approx(curve.sufficiency[i], abs=1e-6)
            assert single.characterisation == pytest.approx(curve.characterisation[i], abs=1e-5)
            assert single.budget == budget


def test_controls_do_worse_than_the_truth() -> None:
    """A measure that a random or an inverted ranking passes would measure nothing."""
    query = toy_query(additive, torch.eye(4), ["a", "b", "c", "d"])
    truth = query.scores("worth", WORTH.double().numpy())
    rng = np.random.default_rng(0)
    curves = fidelity_curves(query, [truth, inverted(truth), *(random_scores(query, rng) for _ in range(50))], [0.5])
    by_truth, by_inverse, *by_chance = (float(curve.characterisation[0]) for curve in curves)
    assert by_inverse < np.mean(by_chance) < by_truth
    assert curves[1].method == "inverted_worth"


def test_the_query_as_it_is_costs_nothing_more() -> None:
    """Two encodings, keep and drop: what is published online may not cost more."""
    asked: list[int] = []

    def counted(x: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
        asked.append(1)
        return additive(x, keep)

    query = toy_query(counted, torch.eye(4), ["a", "b", "c", "d"])
    object.__setattr__(query, "known", 0.8)
    own_fidelity(query, query.scores("worth", WORTH.double().numpy()), 0.3)
    assert len(asked) == 2


def test_ties_go_by_id() -> None:
    query = toy_query(additive, torch.eye(4), ["a", "b", "c", "d"])
    assert ranking(query.scores("x", np.array([1.0, 2.0, 1.0, 2.0]))).tolist() == [1, 3, 0, 2]


def test_refusals() -> None:
    query = toy_query(additive, torch.eye(4), ["a", "b", "c", "d"])
    scores = query.scores("worth", WORTH.double().numpy())
    with pytest.raises(ConfigError, match=r"budgets in \[0, 1\]"):
        fidelity_curves(query, [scores], [1.1])
    other = toy_query(additive, torch.eye(3), ["a", "b", "c"])
    with pytest.raises(ConfigError, match="the query's 3 objects"):
        fidelity_curves(other, [scores])
    with pytest.raises(ConfigError, match="expected explainers among"):
        explain(query, "tea_leaves", np.random.default_rng(0))
