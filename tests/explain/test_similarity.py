"""The question that explainers ask: removal is removal, and how it is cut into portions does not show."""

import numpy as np
import pytest
import torch
from query_cases import any_encoder, class_names, encoder_query, paper_encoder, room, toy_query

from semloc_core.encoding.encoder import ENCODERS
from semloc_core.encoding.variants.perturbed import PerturbedEncoder
from semloc_core.errors import ModelError
from semloc_core.explain.similarity import SimilarityQuery

CLASSES = [0, 1, 1, 2, 3, 0, 2]
OTHER = [0, 1, 2, 2, 3]


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_each_variant_equals_encoding_it_alone(name: str) -> None:
    encoder = any_encoder(name)
    query, batch = encoder_query(encoder, CLASSES, OTHER), room(CLASSES)
    encoder.requires_grad_(False)
    target = encoder(room(OTHER))[0]
    rng = np.random.default_rng(0)
    present = rng.random((9, len(CLASSES))) < 0.6
    found = query.of_objects(present)
    for row, value in zip(present, found, strict=True):
        keep = torch.ones(batch.n_nodes, dtype=torch.bool)
        keep[query.rows] = torch.from_numpy(row)
        assert value == pytest.approx(float(encoder(batch, keep=keep)[0] @ target), abs=1e-6)
    features = torch.rand(5, *batch.features.shape)
    for x, value in zip(features, query.of_features(features)[0], strict=True):
        assert value == pytest.approx(float(encoder(batch.with_features(x))[0] @ target), abs=1e-6)


def test_a_zeroed_object_is_not_a_removed_one() -> None:
    """Explaining removal by zeroing would answer another question."""
    query = encoder_query(paper_encoder(), CLASSES, OTHER)
    zeroed = query.features.clone()
    zeroed[query.rows[0]] = 0
    present = np.ones((1, len(CLASSES)), dtype=bool)
    present[0, 0] = False
    assert abs(float(query.of_features(zeroed[None])[0][0]) - query.of_objects(present)[0]) > 1e-4


@pytest.mark.parametrize("nodes_at_once", [1, 25, 64, 10**6])
def test_portions_do_not_show(nodes_at_once: int) -> None:
    present = np.random.default_rng(1).random((40, len(CLASSES))) < 0.5
    whole = encoder_query(paper_encoder(), CLASSES, OTHER)
    parts = encoder_query(paper_encoder(), CLASSES, OTHER, nodes_at_once)
    np.testing.assert_allclose(parts.of_objects(present), whole.of_objects(present), atol=2e-7)
    path = torch.linspace(0, 1, 30)[:, None, None] * whole.features
    for a, b in zip(parts.of_features(path), whole.of_features(path), strict=True):
        np.testing.assert_allclose(np.asarray(a), np.asarray(b), atol=1e-6)


def test_equal_coalitions_are_evaluated_once() -> None:
    asked: list[int] = []

    def count(x: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
        asked.append(1)
        return keep.sum().float()

    query = toy_query(count, torch.eye(3), ["a", "b", "c"])
    present = np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 0, 0]], dtype=bool)
    assert query.of_objects(present).tolist() == [2, 0, 2, 3, 0]
    assert len(asked) == 3


def test_no_object_at_all() -> None:
    query = encoder_query(paper_encoder(), [], OTHER)
    assert query.ids == ()
    np.testing.assert_allclose(query.of_objects(np.zeros((2, 0), dtype=bool)), query.full, atol=1e-6)


def test_gradients_inside_inference_mode() -> None:
    """The localiser embeds in inference mode; what it kept must still be explainable."""
    encoder = paper_encoder()
    with torch.inference_mode():
        batch = room(CLASSES)
        encoded = encoder.encode(batch)
        target = encoder(room(OTHER))[0]
        query = SimilarityQuery.from_encoder(encoder, batch, target, class_names(batch), encoded)
        inside = query.of_features(query.features[None])[1]
    outside = encoder_query(encoder, CLASSES, OTHER)
    assert torch.equal(inside, outside.of_features(outside.features[None])[1])
    assert query.full == pytest.approx(outside.full, abs=1e-6)


def test_what_can_not_be_asked_is_refused() -> None:
    encoder, batch = paper_encoder(), room(CLASSES)
    perturbed = PerturbedEncoder(encoder, batch)
    n, c = batch.features.shape
    for features, keep in (
        (None, None),
        (torch.zeros(2, n, c + 1), None),
        (torch.zeros(2, n, c, dtype=torch.float64), None),
        (None, torch.ones(2, n)),
        (torch.zeros(2, n, c), torch.ones(3, n, dtype=torch.bool)),
    ):
        with pytest.raises(ModelError, match=r"expected .* \(got"):
            perturbed.embed(features, keep)
    with pytest.raises(ModelError, match="eval mode"):
        PerturbedEncoder(paper_encoder().train(), batch)
    with pytest.raises(ModelError, match="a target of 32 numbers"):
        SimilarityQuery.from_encoder(encoder, batch, torch.zeros(3), class_names(batch))
