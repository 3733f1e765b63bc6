"""Saliency and Integrated Gradients: closed forms, axioms, agreement with Captum."""

import numpy as np
import pytest
import torch
from query_cases import any_encoder, encoder_query, paper_encoder, toy_query
from torch import Tensor

from semloc_core.errors import ConfigError
from semloc_core.explain.explainers.integrated_gradients import integrated_gradients
from semloc_core.explain.explainers.saliency import saliency

CLASSES = [0, 1, 1, 2, 3, 0, 2]
OTHER = [0, 1, 2, 2, 3]
WEIGHT = torch.tensor([[1.0, -2.0], [0.5, 3.0], [0.0, 0.25]])
X = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])


def linear(x: Tensor, keep: Tensor) -> Tensor:
    return (WEIGHT * x * keep[:, None]).sum()


def test_linear_model_in_closed_form() -> None:
    query = toy_query(linear, X, ["a", "b", "a"])
    np.testing.assert_allclose(saliency(query).scores, [3.0, 3.5, 0.25])
    np.testing.assert_allclose(saliency(query, own_class=True).scores, [1.0, 3.0, 0.0])
    found = integrated_gradients(query, steps=1)
    np.testing.assert_allclose(found.scores, [1.0, 3.0, 0.0], atol=1e-6)
    assert found.completeness_gap == pytest.approx(0, abs=1e-6)


def test_polynomial_in_closed_form() -> None:
    """s = u² v with u, v one feature each: IG is ∫ 2α² = 2/3 of u, 1/3 of v."""
    query = toy_query(lambda x, keep: x[0, 0] ** 2 * x[1, 0], torch.tensor([[1.0], [1.0], [1.0]]), ["a", "b", "c"])
    np.testing.assert_allclose(integrated_gradients(query, steps=2).scores, [2 / 3, 1 / 3, 0], atol=1e-6)


@pytest.mark.parametrize("name", ["paper", "rings", "bag_of_words", "tfidf"])
@pytest.mark.parametrize("baseline", ["zero", "uniform", "mean"])
def test_completeness(name: str, baseline: str) -> None:
    """Scores and gap sum to s(x) - s(baseline), and for a smooth encoder the gap is quadrature's alone."""
    query = encoder_query(any_encoder(name), CLASSES, OTHER)
    found = integrated_gradients(query, steps=50, baseline=baseline)
    start = torch.zeros_like(query.features)
    if baseline == "uniform":
        start[query.rows] = 1 / start.shape[1]
    elif baseline == "mean":
        start[query.rows] = query.features[query.rows].mean(0)
    ends = query.of_features(torch.stack([start, query.features]))[0]
    assert found.scores.sum() + found.completeness_gap == pytest.approx(ends[1] - ends[0], abs=1e-6)
    if name == "paper" or (name != "rings" and baseline != "zero"):
        assert abs(found.completeness_gap) < 1e-3
        assert np.abs(found.scores).max() > 1e-3


def test_the_gap_falls_with_steps() -> None:
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    gaps = [abs(integrated_gradients(query, steps=n).completeness_gap) for n in (1, 4, 50)]
    assert gaps[2] < 1e-4 < gaps[0]
    assert gaps[2] < gaps[1]


def test_the_gap_says_that_a_zero_baseline_means_nothing_to_counts_of_unit_length() -> None:
    query = encoder_query(any_encoder("rings"), CLASSES, OTHER)
    found = integrated_gradients(query)
    assert found.scores.sum() == pytest.approx(0, abs=1e-4)
    assert found.completeness_gap == pytest.approx(query.full, abs=1e-4)


def test_symmetry_and_dummy() -> None:
    """Two objects of one class in one place get the same; an object without effect gets nothing."""
    query = encoder_query(paper_encoder(), [1, 0, 2, 1, 0, 2, 3], OTHER)  # o0 and o3: class 1, seen from q
    score = dict(zip(query.ids, integrated_gradients(query).scores.tolist(), strict=True))
    steep = dict(zip(query.ids, saliency(query).scores.tolist(), strict=True))
    assert score["o0"] == pytest.approx(score["o3"], abs=1e-7)
    assert steep["o0"] == pytest.approx(steep["o3"], abs=1e-6)
    query = toy_query(lambda x, keep: torch.tanh(x[0] @ x[1]), X, ["a", "b", "a"])
    assert integrated_gradients(query).scores[2] == 0
    assert saliency(query).scores[2] == 0


@pytest.mark.parametrize("name", ["paper", "tfidf", "rings"])
def test_agrees_with_captum(name: str) -> None:
    attr = pytest.importorskip("captum.attr")
    query = encoder_query(any_encoder(name), CLASSES, OTHER)
    x = query.features[None]
    start = torch.full_like(x, 0.1)  # on rings a way from zero has its whole change in its first point

    reference = attr.IntegratedGradients(query.function)
    theirs, gap = reference.attribute(x, start, n_steps=50, return_convergence_delta=True)
    ours = integrated_gradients(query, steps=50, baseline=start[0])
    by_node = theirs[0].sum(1)
    np.testing.assert_allclose(ours.scores, by_node[query.rows].detach().numpy(), atol=1e-5)
    places = float(by_node.sum() - by_node[query.rows].sum())
    assert ours.completeness_gap == pytest.approx(places - float(gap[0]), abs=1e-5)

    steep = attr.Saliency(query.function).attribute(x.clone().requires_grad_(True))
    np.testing.assert_allclose(saliency(query).scores, steep[0].sum(1)[query.rows].numpy(), atol=1e-6)


def test_portions_and_repetition_do_not_show() -> None:
    first = integrated_gradients(encoder_query(paper_encoder(), CLASSES, OTHER))
    again = integrated_gradients(encoder_query(paper_encoder(), CLASSES, OTHER))
    cut = integrated_gradients(encoder_query(paper_encoder(), CLASSES, OTHER, nodes_at_once=30))
    assert first.scores.tobytes() == again.scores.tobytes()
    np.testing.assert_allclose(cut.scores, first.scores, atol=1e-6)


def test_refusals() -> None:
    query = toy_query(linear, X, ["a", "b", "a"])
    with pytest.raises(ConfigError, match="at least one step"):
        integrated_gradients(query, steps=0)
    with pytest.raises(ConfigError, match=r"expected a .* baseline"):
        integrated_gradients(query, baseline=torch.zeros(2, 2))
    with pytest.raises(ConfigError, match="expected a baseline among"):
        integrated_gradients(query, baseline="nought")  # type: ignore[arg-type]
