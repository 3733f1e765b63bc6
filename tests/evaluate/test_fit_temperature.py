"""The general encoder's temperature: what it is fitted to, on a small scale."""

import numpy as np

from semloc_core.evaluate.fit_temperature import asked
from semloc_core.evaluate.relocalise import Arena
from semloc_core.graph import GraphArrays, load_labelspace
from semloc_core.sources import KINDS, draw_pair
from semloc_core.training import honest_temperature


def test_queries_of_arenas_of_any_size_are_asked_in_their_own_maps_only() -> None:
    space = load_labelspace("coco")
    pairs = [draw_pair(KINDS["home"], np.random.default_rng([1, number])) for number in range(2)]
    maps, queries = (tuple(GraphArrays.from_scene_graph(pair[side].graph, space) for pair in pairs) for side in (0, 1))
    one, both = Arena(space, maps[:1], queries[:1]), Arena(space, maps, queries)
    similarity, near, right = asked([one, both])
    assert similarity.shape == near.shape == (3 * 40, maps[0].n_places + maps[1].n_places)
    assert np.isneginf(similarity[:40, maps[0].n_places :]).all()
    assert not near[:40, maps[0].n_places :].any()
    assert np.isfinite(similarity[40:]).all()
    assert near[np.arange(120), similarity.argmax(axis=1)].all()
    assert right.mean() > 0.9
    assert 0.0005 < honest_temperature(similarity, near, right) < 0.02
