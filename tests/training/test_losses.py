import math

import pytest
import torch

from semloc_core.training.config import TrainConfig
from semloc_core.training.losses import build_loss, contrastive, ignore_radius, infonce, triplet

ALL = [contrastive, triplet, infonce]


def unit(*degrees: float) -> torch.Tensor:
    angle = torch.tensor(degrees).deg2rad()
    return torch.stack([angle.cos(), angle.sin()], 1)


def mask(*rows: list[int]) -> torch.Tensor:
    return torch.tensor(rows, dtype=torch.bool)


def chord(degrees: float) -> float:
    return 2 * math.sin(math.radians(degrees) / 2)


def test_contrastive_closed_form():
    loss = contrastive(unit(0), unit(60, 30, 180), mask([1, 0, 0]))
    assert loss.item() == pytest.approx(chord(60) ** 2 / 2 + (1 - chord(30)) ** 2 / 2 / 2, rel=1e-5)


def test_contrastive_margin_reaches_farther_negatives():
    assert contrastive(unit(0), unit(90), mask([0])).item() == 0
    assert contrastive(unit(0), unit(90), mask([0]), margin=2.0).item() == pytest.approx((2 - math.sqrt(2)) ** 2 / 2)


def test_triplet_sets_each_positive_against_the_nearest_negative():
    loss = triplet(unit(0), unit(10, 50, 40, 170), mask([1, 1, 0, 0]), margin=0.7)
    expected = [0.7 + chord(d) - chord(40) for d in (10, 50)]
    assert loss.item() == pytest.approx(sum(expected) / 2, rel=1e-4)


def test_batch_hard_takes_the_farthest_positive_only():
    loss = triplet(unit(0), unit(10, 50, 40, 170), mask([1, 1, 0, 0]), margin=0.2, mining="batch_hard")
    assert loss.item() == pytest.approx(0.2 + chord(50) - chord(40), rel=1e-4)


def test_triplet_is_zero_when_the_margin_is_kept():
    assert triplet(unit(0), unit(5, 170), mask([1, 0])).item() == 0


def test_infonce_closed_form_with_several_positives():
    loss = infonce(unit(0), unit(0, 60, 180), mask([1, 1, 0]), temperature=0.7)
    total = math.log(sum(math.exp(s / 0.7) for s in (1, 0.5, -1)))
    assert loss.item() == pytest.approx(total - (1 + 0.5) / 2 / 0.7, rel=1e-5)


@pytest.mark.parametrize("loss", ALL)
def test_gradient_pulls_positives_and_pushes_negatives(loss):
    z = unit(0).requires_grad_()
    loss(z, unit(20, -20), mask([1, 0]), None).backward()
    towards_positive = unit(90)[0]
    assert (-z.grad[0] @ towards_positive).item() > 0


@pytest.mark.parametrize("loss", [triplet, infonce])
def test_a_query_without_positives_is_left_out(loss):
    alone = loss(unit(0), unit(15, 40), mask([1, 0]))
    both = loss(unit(0, 90), unit(15, 40), mask([1, 0], [0, 0]))
    assert both.item() == pytest.approx(alone.item(), rel=1e-5)


def test_contrastive_still_repels_for_a_query_without_positives():
    both = contrastive(unit(0, 90), unit(15, 60), mask([1, 0], [0, 0]))
    negatives = [chord(60), chord(75), chord(30)]
    repel = sum(max(0.0, 1 - d) ** 2 / 2 for d in negatives) / 3
    assert both.item() == pytest.approx(chord(15) ** 2 / 2 + repel, rel=1e-5)


@pytest.mark.parametrize("loss", ALL)
def test_nothing_to_judge_gives_zero_with_a_gradient(loss):
    z = unit(0, 90).requires_grad_()
    value = loss(z, unit(0, 90), mask([0, 0], [0, 0]), mask([1, 1], [1, 1]))
    value.backward()
    assert value.item() == 0
    assert torch.equal(z.grad, torch.zeros_like(z))


@pytest.mark.parametrize("loss", ALL)
def test_ignored_pairs_change_nothing(loss):
    without = loss(unit(0), unit(25, 10), mask([1, 0]))
    ignored = loss(unit(0), unit(25, 10, 1, 50), mask([1, 0, 0, 1]), mask([0, 0, 1, 1]))
    assert ignored.item() == pytest.approx(without.item(), rel=1e-5)


@pytest.mark.parametrize("loss", ALL)
def test_equal_and_zero_embeddings_have_finite_gradients(loss):
    """A place in view of nothing embeds to zero; two places in view of the same embed alike."""
    z = torch.cat([unit(0, 0), torch.zeros(1, 2)]).requires_grad_()
    loss(z, z, mask([1, 0, 0], [0, 1, 0], [0, 1, 1]), None).backward()
    assert torch.isfinite(z.grad).all()


def test_only_the_triplet_loss_ignores_a_gap():
    radii = [ignore_radius(TrainConfig(loss=name)) for name in ("infonce", "contrastive", "triplet")]
    assert radii == [4.0, 4.0, 8.0]


@pytest.mark.parametrize(
    ("name", "expected"),
    [("contrastive", contrastive), ("triplet", triplet), ("infonce", infonce)],
)
def test_configuration_names_the_loss(name, expected):
    pair = unit(0, 30), unit(10, 40, 80), mask([1, 0, 0], [0, 1, 0])
    assert torch.equal(build_loss(TrainConfig(loss=name))(*pair, None), expected(*pair))
