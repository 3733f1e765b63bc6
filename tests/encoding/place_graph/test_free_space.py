import numpy as np
import pytest
from small_building import SPACE, building_update, make_model

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import embed_graph
from semloc_core.encoding.place_graph import extract, extract_all, repeat, take_stars, union
from semloc_core.encoding.place_graph.free_space import free_space
from semloc_core.errors import GraphError
from semloc_core.evaluate.online.fragments import embed_walk
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.sources.simulate.walks import WalkConfig, walk

BANDS = ((0.0, 1.0), (3.0, 1.5))


def test_area_by_band_written_out_and_free_of_order() -> None:
    distances, cells = np.array([0.0, 1.0, 3.0]), np.array([1.0, 4.0, 0.25])
    near = 1 + 4 * np.exp(-0.5) + 0.25 * np.exp(-4.5)
    far = np.exp(-2.0) + 4 * np.exp(-0.5 * (2 / 1.5) ** 2) + 0.25
    found = free_space(distances, cells, BANDS)
    np.testing.assert_allclose(found, [near, far], rtol=1e-6)
    turned = free_space(distances[::-1], cells[::-1], BANDS)
    assert found.tobytes() == turned.tobytes()


def test_a_place_alone_has_no_free_space() -> None:
    assert free_space(np.zeros(1), np.zeros(1), BANDS).tolist() == [0.0, 0.0]


def test_online_and_whole_building_measure_the_same_bits() -> None:
    graph = SceneGraph.from_update(building_update(length=60, objects=25, spacing=0.73))
    arrays = GraphArrays.from_scene_graph(graph, SPACE)
    extraction = build_encoder("geodesic_attention", None, len(SPACE)).extraction
    whole = extract_all(arrays, len(SPACE), extraction)
    online = extract(graph, Visibility(graph, 0.0), SPACE, list(arrays.place_ids), extraction)
    assert whole.free_space is not None
    assert online.free_space is not None
    assert whole.free_space.numpy().tobytes() == online.free_space.numpy().tobytes()
    assert (whole.free_space > 0).any()


def test_density_of_places_hardly_matters() -> None:
    """A corridor is a line: half the spacing gives twice the places of a quarter the area."""
    extraction = build_encoder("geodesic_attention", None, len(SPACE)).extraction
    areas = []
    for spacing, length in ((1.0, 61), (0.5, 121)):
        graph = SceneGraph.from_update(building_update(length=length, spacing=spacing))
        batch = extract(graph, Visibility(graph, 0.0), SPACE, [f"p{length // 2}"], extraction)
        assert batch.free_space is not None
        areas.append(batch.free_space[0].numpy() / spacing)
    np.testing.assert_allclose(areas[0], areas[1], rtol=0.2)


def test_copies_unions_and_choices_carry_free_space_along() -> None:
    arrays = GraphArrays.from_scene_graph(SceneGraph.from_update(building_update()), SPACE)
    extraction = build_encoder("geodesic_attention", None, len(SPACE)).extraction
    batch = extract_all(arrays, len(SPACE), extraction)
    assert batch.free_space is not None
    p = batch.n_roots
    for twice in (repeat(batch, 2)[0], union([batch, batch])[0]):
        assert twice.free_space is not None
        assert (twice.free_space[:p] == batch.free_space).all()
        assert (twice.free_space[p:] == batch.free_space).all()
    chosen = take_stars(batch, np.array([7, 2]))
    assert chosen.free_space is not None
    assert (chosen.free_space == batch.free_space[[7, 2]]).all()
    assert chosen.node_ids[:2] == (batch.node_ids[7], batch.node_ids[2])
    plain = extract_all(arrays, len(SPACE), build_encoder("rings", None, len(SPACE)).extraction)
    with pytest.raises(GraphError, match="expected free space of all batches or of none"):
        union([batch, plain])


def test_along_a_walk_the_embedding_is_that_of_the_graph_so_far() -> None:
    arrays = GraphArrays.from_scene_graph(SceneGraph.from_update(building_update(length=40)), SPACE)
    model = make_model("geodesic_attention")
    path = walk(arrays, WalkConfig(distance_m=15.0), np.random.default_rng(0))
    together = embed_walk(model, path)
    for step in (0, path.steps // 2, path.steps - 1):
        part, place = path.part(step)
        np.testing.assert_allclose(together[step], embed_graph(model, part)[place], atol=1e-6)
