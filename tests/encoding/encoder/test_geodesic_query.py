"""Geodesic attention in numpy is geodesic attention: any star, any option, any nodes gone, any weights."""

from __future__ import annotations

import numpy as np
import torch
from graph_strategies import valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.encoding.encoder.geodesic_attention import GeodesicAttentionConfig, GeodesicAttentionEncoder
from semloc_core.encoding.encoder.geodesic_query import GeodesicQuery
from semloc_core.encoding.place_graph import reach_batch
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import SceneGraphUpdate

SPACE = Labelspace("test", ("box", "chair", "couch"))
CLOSE = 2e-6


def encoder_of(space_weight: float) -> GeodesicAttentionEncoder:
    """Random weights, scores among them."""
    config = GeodesicAttentionConfig(
        centres=(0.0, 2.0, 4.0), widths=(1.0, 1.5, 2.0), radius_m=5.0, dimension=6, space_weight=space_weight
    )
    encoder = GeodesicAttentionEncoder(config, len(SPACE), torch.Generator().manual_seed(1))
    with torch.no_grad():
        encoder.score.normal_(generator=torch.Generator().manual_seed(2))
    return encoder.eval()


@given(valid_updates(full=True), st.sampled_from([0.0, 0.07]), st.integers(0, 99), st.booleans())
@settings(max_examples=80)
def test_it_is_the_same_function(message: SceneGraphUpdate, space_weight: float, seed: int, weighed: bool) -> None:
    graph = SceneGraph.from_update(message)
    encoder = encoder_of(space_weight)
    query, rng = GeodesicQuery(encoder), np.random.default_rng(seed)
    for place in sorted(graph.places)[:4]:
        batch = reach_batch(graph, SPACE, [place], encoder.extraction.radius_m, encoder.extraction.bands)
        if weighed:  # as objects of a map into which traversals were merged
            batch = batch.with_features(batch.features * torch.tensor([0.5, 1.0, 0.2]))
        assert GeodesicQuery.fits(encoder, batch)
        with torch.inference_mode():
            wanted = encoder.encode(batch)
        found = query.encode(batch)
        for name in ("embedding", "credit", "self_share"):
            # What is left of 1 has the error of every float32 sum before it, which the encoder's are.
            close = 5 * CLOSE if name == "self_share" else CLOSE
            assert torch.allclose(getattr(found, name), getattr(wanted, name), atol=close), name
        keep = rng.random((5, batch.n_nodes)) < 0.5
        keep[:, 0] = True
        with torch.inference_mode():
            removed = torch.stack([encoder(batch, keep=torch.from_numpy(row))[0] for row in keep])
        assert np.allclose(query.embed(batch, keep), removed.numpy(), atol=CLOSE)


def test_other_batches_are_left_to_the_encoder_itself() -> None:
    encoder = encoder_of(0.07)
    graph = SceneGraph()
    graph.places.update(p=(0.0, 0.0, 0.0), q=(1.0, 0.0, 0.0))
    graph.neighbours.update(p={"q": 1.0}, q={"p": 1.0})
    reach, bands = encoder.extraction.radius_m, encoder.extraction.bands
    assert GeodesicQuery.fits(encoder, reach_batch(graph, SPACE, ["p"], reach, bands))
    assert not GeodesicQuery.fits(encoder, reach_batch(graph, SPACE, ["p", "q"], reach, bands))
    assert not GeodesicQuery.fits(encoder, reach_batch(graph, SPACE, ["p"], reach))
    other = Labelspace("other", ("box",))
    assert not GeodesicQuery.fits(encoder, reach_batch(graph, other, ["p"], reach, bands))
