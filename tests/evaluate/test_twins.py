"""What looks alike: twins on another day are, other buildings of the kind are not; how few objects tell a place."""

import numpy as np
import pytest

from semloc_core.encoding import embed_graph, general_model
from semloc_core.evaluate import LookAlikes, look_alikes
from semloc_core.graph import GraphArrays, SceneGraph, storeys_of
from semloc_core.sources.world import KINDS, draw_stacked


def look(*graphs: SceneGraph) -> LookAlikes:
    model = general_model(graphs)
    arrays = [GraphArrays.from_scene_graph(graph, model.labelspace) for graph in graphs]
    keys = [
        (b, storeys_on[id_])
        for b, (graph, each) in enumerate(zip(graphs, arrays, strict=True))
        for storeys_on in (storeys_of(graph),)
        for id_ in each.place_ids
    ]
    floor = np.unique(np.array(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return look_alikes(
        np.concatenate([embed_graph(model, each) for each in arrays]).astype(np.float32),
        np.concatenate([each.place_positions for each in arrays]),
        floor,
        [(each.n_places, graph) for each, graph in zip(arrays, graphs, strict=True)],
    )


def home(seed: int) -> tuple[SceneGraph, SceneGraph]:
    mapped, again = draw_stacked(KINDS["home"], 1, np.random.default_rng(seed))
    return mapped.graph, again.graph


def test_a_building_seen_on_another_day_is_a_twin_and_another_home_is_not() -> None:
    (one, one_again), (two, _) = home(1), home(2)
    assert look(one, two).twins == []
    assert look(one, two, one_again).twins == [[0, 2]]


@pytest.mark.parametrize("alike", [True, False])
def test_storeys_that_are_alike(alike: bool) -> None:
    tower, _ = draw_stacked(KINDS["home"], 3, np.random.default_rng(3), alike=alike)
    found = look(tower.graph)
    assert found.twins == ([[0, 1, 2]] if alike else [])
    assert (found.needed[0] is None) is alike, "in twin storeys no number of objects tells places apart"
    assert (found.near > 0).all()


def test_a_graph_without_objects_has_no_doubles() -> None:
    bare = SceneGraph()
    bare.places.update({f"p{i}": (float(i), 0.0, 0.0) for i in range(9)})
    found = look_alikes(np.zeros((9, 4), dtype=np.float32), np.zeros((9, 3)), np.zeros(9, dtype=np.int64), [(9, bare)])
    assert (found.twins, found.doubled.tolist(), found.needed) == ([], [0.0], (None, None))
    assert found.near.tolist() == [0] * 9
