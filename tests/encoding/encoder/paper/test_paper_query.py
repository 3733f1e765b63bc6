"""The paper's encoder in numpy is the paper's encoder: any graph, any option, any nodes gone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from graph_strategies import update, valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.encoder.paper.encoder import PaperConfig, PaperEncoder
from semloc_core.encoding.encoder.paper.query import PaperQuery
from semloc_core.encoding.encoder.query import QueryEncoder
from semloc_core.encoding.place_graph import Batch, EgoRows, ego_batch, reach_batch
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.wire import Object, Place, SceneGraphUpdate

SPACE = Labelspace("test", ("box", "chair", "couch"))
CLOSE = 2e-6


def encoder_of(config: PaperConfig) -> PaperEncoder:
    """Random weights, batch norms as if they had seen data."""
    encoder = PaperEncoder(config, len(SPACE), torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    for layer in encoder.layers:
        layer.norm.running_mean.uniform_(-0.5, 0.5, generator=generator)
        layer.norm.running_var.uniform_(0.3, 2.0, generator=generator)
        layer.norm.weight.data.uniform_(0.5, 1.5, generator=generator)
        layer.norm.bias.data.uniform_(-0.5, 0.5, generator=generator)
    return encoder.eval()


configs = st.builds(
    PaperConfig,
    layers=st.integers(1, 3),
    hidden=st.just(8),
    heads=st.integers(1, 3),
    gat=st.booleans(),
    self_loops=st.booleans(),
    dimension=st.just(6),
)


@given(valid_updates(full=True), configs, st.integers(0, 99))
@settings(max_examples=80)
def test_it_is_the_same_function(message: SceneGraphUpdate, config: PaperConfig, seed: int) -> None:
    graph = SceneGraph.from_update(message)
    encoder = encoder_of(config)
    query = PaperQuery(encoder)
    visibility = Visibility(graph, 4.0)
    for place in sorted(graph.places)[:4]:
        batch = ego_batch(graph, visibility, SPACE, [place], encoder.hops)
        assert PaperQuery.fits(encoder, batch)
        with torch.inference_mode():
            wanted = encoder.encode(batch)
        found = query.encode(batch)
        assert torch.allclose(found.embedding, wanted.embedding, atol=CLOSE)
        assert (found.credit is None) == (wanted.credit is None) == (not config.gat)
        if wanted.credit is not None and found.credit is not None:
            assert torch.allclose(found.credit, wanted.credit, atol=CLOSE)
            assert torch.allclose(found.self_share, wanted.self_share, atol=CLOSE)
        keep = np.random.default_rng(seed).random((3, batch.n_nodes)) < 0.5
        keep[:, 0] = True
        with torch.inference_mode():
            removed = torch.stack([encoder(batch, keep=torch.from_numpy(row))[0] for row in keep])
        assert np.allclose(query.embed(batch, keep), removed.numpy(), atol=CLOSE)


def small() -> tuple[SceneGraph, Visibility]:
    graph = SceneGraph()
    places = [Place(f"p{i}", (float(i), 0.0, 0.0)) for i in range(4)]
    edges = [("p0", "p1"), ("p1", "p2"), ("p2", "p3"), ("p1", "o")]
    graph.apply(update(places, [Object("o", "chair", (1.0, 1.0, 0.0))], edges, full=True))
    return graph, Visibility(graph, 4.0)


def test_other_batches_are_left_to_the_encoder_itself() -> None:
    graph, visibility = small()
    encoder = encoder_of(PaperConfig())
    one = EgoRows(graph, visibility, SPACE).batch("p0", encoder.hops)
    assert PaperQuery.fits(encoder, one)
    weighed = one.with_features(one.features * 0.5)
    two = ego_batch(graph, visibility, SPACE, ["p0", "p1"], encoder.hops)
    shallow = ego_batch(graph, visibility, SPACE, ["p0"], 1)
    for batch in (weighed, two, shallow):
        assert not PaperQuery.fits(encoder, batch)
    rings = build_encoder("rings", None, len(SPACE))
    assert not PaperQuery.fits(rings, one)
    assert not PaperQuery.fits(encoder.train(), one)


@pytest.mark.parametrize("name", ["paper", "rings", "geodesic_attention"])
def test_a_query_encoder_says_what_the_encoder_says(name: str) -> None:
    graph, visibility = small()
    encoder = build_encoder(name, None, len(SPACE), torch.Generator().manual_seed(3)).eval()
    extraction = encoder.extraction
    batch: Batch = (
        ego_batch(graph, visibility, SPACE, ["p1"], extraction.hops)
        if extraction.kind == "ego"
        else reach_batch(graph, SPACE, ["p1"], extraction.radius_m, extraction.bands)
    )
    queries = QueryEncoder(encoder)
    with torch.inference_mode():
        wanted = encoder.encode(batch)
    assert torch.allclose(queries.encode(batch).embedding, wanted.embedding, atol=CLOSE)
    keep = np.ones((2, batch.n_nodes), dtype=bool)
    found = queries.embed(batch, keep)
    assert found is None if name == "rings" else found is None or np.allclose(found, wanted.embedding, atol=CLOSE)
