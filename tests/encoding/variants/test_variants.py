"""The layout for many variants is the paper's encoder: embeddings and gradients, on every kind of it."""

import numpy as np
import pytest
import torch
from query_cases import room
from small_building import SPACE, building_update

from semloc_core.encoding import PaperEncoder, build_encoder
from semloc_core.encoding.encoder.paper.encoder import PaperConfig
from semloc_core.encoding.place_graph import Batch, repeat
from semloc_core.encoding.place_graph.cut import PlaceBatches
from semloc_core.encoding.variants import state_table
from semloc_core.encoding.variants.copies import MOST_NODES, PaperCopies
from semloc_core.encoding.variants.perturbed import PerturbedEncoder
from semloc_core.encoding.variants.removals import PaperRemovals
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph

CONFIGS = [
    PaperConfig(),
    PaperConfig(layers=1, heads=1),
    PaperConfig(layers=3, hidden=16, heads=2),
    PaperConfig(self_loops=False),
    PaperConfig(layers=2, gat=False),
    PaperConfig(layers=1, gat=False),
]


def case(config: PaperConfig, place: int = 5, **options) -> tuple[PaperEncoder, Batch]:
    graph = SceneGraph()
    graph.apply(building_update(**options))
    encoder = PaperEncoder(config, len(SPACE), torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    for layer in encoder.layers:
        layer.norm.running_mean.uniform_(-0.5, 0.5, generator=generator)
        layer.norm.running_var.uniform_(0.3, 2.0, generator=generator)
    arrays = GraphArrays.from_scene_graph(graph, SPACE, "home")
    return encoder.eval(), PlaceBatches(arrays, len(SPACE), encoder.extraction).of(place)


def one_by_one(encoder: PaperEncoder, batch: Batch, features, keep) -> torch.Tensor:
    """Each variant alone through the encoder."""
    k = len(features if features is not None else keep)
    return torch.cat(
        [
            encoder(
                batch if features is None else batch.with_features(features[i]), keep=None if keep is None else keep[i]
            )
            for i in range(k)
        ]
    )


@pytest.mark.parametrize("config", CONFIGS, ids=str)
@pytest.mark.parametrize("given", ["features", "keep", "both"])
def test_embeds_as_the_encoder_does(config: PaperConfig, given: str) -> None:
    encoder, batch = case(config)
    generator = torch.Generator().manual_seed(3)
    features = torch.rand(7, *batch.features.shape, generator=generator)
    keep = torch.rand(7, batch.n_nodes, generator=generator) < 0.6
    keep[:, 0] = True
    keep[0] = torch.arange(batch.n_nodes) == 0  # everything but the root is gone
    x, mask = (features if given != "keep" else None), (keep if given != "features" else None)
    with torch.no_grad():
        want = one_by_one(encoder, batch, x, mask)
    torch.testing.assert_close(PaperCopies(encoder, batch).embed(x, mask), want, atol=2e-6, rtol=0)


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_removals_embed_as_the_encoder_does(config: PaperConfig) -> None:
    """Objects and places gone, in one table; and nothing gone at all."""
    encoder, batch = case(config)
    keep = torch.rand(40, batch.n_nodes, generator=torch.Generator().manual_seed(3)) < 0.6
    keep[:, 0] = True
    keep[0] = torch.arange(batch.n_nodes) == 0
    keep[1] = True
    removals = PaperRemovals(encoder, batch, PaperCopies(encoder, batch))
    with torch.no_grad():
        want = one_by_one(encoder, batch, None, keep)
        torch.testing.assert_close(removals.embed(keep), want, atol=2e-6, rtol=0)
        torch.testing.assert_close(removals.embed(keep[1:2]), want[1:2], atol=2e-6, rtol=0)


@pytest.mark.parametrize("limit", ["MOST_CODES", "EXACT"])
def test_where_counts_are_too_many_for_a_table(monkeypatch, limit: str) -> None:
    """Told apart by sorting, or embedded without a table: the same numbers."""
    encoder, batch = case(PaperConfig())
    keep = torch.rand(30, batch.n_nodes, generator=torch.Generator().manual_seed(3)) < 0.6
    keep[:, 0] = True
    whole = PaperRemovals(encoder, batch, PaperCopies(encoder, batch)).embed(keep)
    monkeypatch.setattr(state_table, limit, 2)
    removals = PaperRemovals(encoder, batch, PaperCopies(encoder, batch))
    torch.testing.assert_close(removals.embed(keep), whole, atol=2e-6, rtol=0)


def test_each_count_is_in_the_table_once() -> None:
    """Two objects of one kind are interchangeable: four ways to keep them are three states."""
    adjacency = torch.tensor([[0.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    first = state_table.FirstLayer(adjacency, torch.tensor([0, 1, 1, 0]))
    keep = torch.tensor([[1, 0, 0, 1], [1, 0, 1, 1], [1, 1, 0, 1], [1, 1, 1, 1]], dtype=torch.bool)
    table = first.table(keep)
    assert table is not None
    assert table.counts[table.index[:, 0]].tolist() == [[1, 0], [1, 1], [1, 1], [1, 2]]
    assert len(set(table.index[:, 0].tolist())) == 3
    assert table.counts[table.index[:, 1]].tolist() == [[1, 0]] * 4
    assert table.own[table.index].tolist() == [[0, 1]] * 4


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_its_gradient_is_that_of_automatic_differentiation(config: PaperConfig) -> None:
    encoder, batch = case(config)
    generator = torch.Generator().manual_seed(4)
    target = torch.randn(encoder.dimension, generator=generator)
    rows = torch.randperm(batch.n_nodes, generator=generator)[:9]  # places too, in any order
    along = torch.linspace(0.1, 1, 5)[:, None, None] * batch.features  # objects of a class are alike
    for features in (along, torch.rand(5, *batch.features.shape, generator=generator)):
        leaf = features.clone().requires_grad_(True)
        value = one_by_one(encoder, batch, leaf, None) @ target
        (want,) = torch.autograd.grad(value.sum(), leaf)
        got_value, got = PaperCopies(encoder, batch).gradient(features, target, rows)
        torch.testing.assert_close(got_value, value.detach(), atol=5e-6, rtol=0)
        torch.testing.assert_close(got, want[:, rows], atol=1e-5 * float(want.abs().max()) + 1e-7, rtol=1e-4)


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_a_lone_place(config: PaperConfig) -> None:
    encoder, batch = case(config, place=0, length=1, objects=0, query=None)
    features = torch.rand(3, 1, len(SPACE), generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        want = one_by_one(encoder, batch, features, None)
    copies = PaperCopies(encoder, batch)
    torch.testing.assert_close(copies.embed(features, None), want, atol=2e-6, rtol=0)
    assert copies.gradient(features, want[0], torch.tensor([0]))[1].isfinite().all()


def test_what_it_is_not_made_for_goes_through_the_union() -> None:
    encoder, batch = case(PaperConfig())
    assert PaperCopies.fits(encoder, batch)
    assert not PaperCopies.fits(build_encoder("rings", None, len(SPACE)), batch)
    many = repeat(batch, 1 + MOST_NODES // batch.n_nodes)[0]
    assert not PaperCopies.fits(encoder, many)


def test_both_ways_explain_alike(monkeypatch) -> None:
    encoder = PaperEncoder(None, 4, torch.Generator().manual_seed(1)).eval()
    batch = room([0, 1, 2, 3, 1, 0])
    keep = torch.from_numpy(np.random.default_rng(0).random((40, batch.n_nodes)) < 0.5) | ~batch.is_object
    fast = PerturbedEncoder(encoder, batch).embed(keep=keep)
    monkeypatch.setattr(PaperCopies, "fits", staticmethod(lambda encoder, batch: False))
    slow = PerturbedEncoder(encoder, batch).embed(keep=keep)
    torch.testing.assert_close(fast, slow, atol=2e-6, rtol=0)
