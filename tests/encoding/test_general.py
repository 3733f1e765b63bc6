"""The general encoder: any class names, nothing learned of any, and what it tells apart read off the map at hand."""

import numpy as np
import pytest
from small_building import building_update

from semloc_core.encoding.encoder.query import QueryEncoder
from semloc_core.encoding.general import MOST_PLACES, TEMPERATURE, general_model
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.encoding.place_graph import reach_all_batch
from semloc_core.errors import ModelError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.metrics import top
from semloc_core.sources.world import KINDS, draw_pair
from semloc_core.training.config import PERTURBATIONS
from semloc_core.training.views.perturb import perturb
from semloc_core.wire import Object, Place, SceneGraphUpdate


@pytest.fixture(scope="module")
def home():
    """A generated home, its labelspace, and what a detector saw of it on another day."""
    world, _ = draw_pair(KINDS["home"], np.random.default_rng(51))
    space = world.labelspace
    mapped = GraphArrays.from_scene_graph(world.graph, space, "home")
    return mapped, space, perturb(mapped, space, PERTURBATIONS["detector"], np.random.default_rng(1))


def success(model: Model, mapped: GraphArrays, seen: GraphArrays) -> float:
    """Share of the places seen whose most similar mapped place is within 4 m."""
    best = top(embed_graph(model, seen) @ embed_graph(model, mapped).T, 1)[:, 0]
    return float((np.linalg.norm(mapped.place_positions[best] - seen.place_positions, axis=1) <= 4.0).mean())


def test_places_are_found_again_that_were_sampled_anew(home) -> None:
    mapped, space, seen = home
    model = general_model([mapped], space)
    assert (model.encoder.name, model.encoder.dimension) == ("geodesic_attention", 64)
    assert model.temperature == TEMPERATURE
    assert success(model, mapped, seen) > 0.9


def test_names_mean_nothing_to_it(home) -> None:
    """Classes renamed, and so in another order: the same places are as alike as before."""
    mapped, space, seen = home
    order = np.random.default_rng(3).permutation(len(space))
    renamed = Labelspace("odd", tuple(f"zeppelin {i}" for i in range(len(space))))

    def with_names(graph: GraphArrays) -> GraphArrays:
        number = np.where(graph.object_classes < 0, -1, order[graph.object_classes])
        return GraphArrays(**{**vars(graph), "object_classes": number})

    plain, odd = general_model([mapped], space), general_model([with_names(mapped)], renamed)
    before = embed_graph(plain, seen) @ embed_graph(plain, mapped).T
    after = embed_graph(odd, with_names(seen)) @ embed_graph(odd, with_names(mapped)).T
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_a_class_that_is_everywhere_says_nothing_and_one_that_is_somewhere_does(write_row) -> None:
    everywhere = write_row([("lamp", float(x)) for x in range(0, 40, 2)] + [("piano", 3.0)])
    model = general_model([everywhere])
    score = model.encoder.value.weight.square().sum(0).sqrt()[: 8 * 2].view(8, 2)  # heads x (lamp, piano)
    spread = embed_graph(model, GraphArrays.from_scene_graph(everywhere, model.labelspace)).std(axis=0).max()
    assert spread > 0.1
    assert score[0, model.labelspace.index("piano")] > score[0, model.labelspace.index("lamp")]


@pytest.fixture
def write_row():
    """A graph of 40 places in a row, an object of a class at each of the given x."""

    def make(things: list[tuple[str, float]], places: int = 40) -> SceneGraph:
        rows = [Place(f"p{i:02}", (float(i), 0.0, 0.0)) for i in range(places)]
        objects = [Object(f"o{i}", class_, (x, 1.0, 0.0)) for i, (class_, x) in enumerate(things)]
        edges = [(f"p{i:02}", f"p{i + 1:02}") for i in range(places - 1)]
        edges += [(f"p{int(x):02}", f"o{i}") for i, (_, x) in enumerate(things)]
        return SceneGraph.from_update(
            SceneGraphUpdate("semloc/scene_graph_update/1", 0, "map", 0, True, rows, objects, edges, None)
        )

    return make


@pytest.mark.parametrize("things", [[], [("unknown", 1.0)], [("class_7", 0.0)], [("", 0.0)]])
@pytest.mark.parametrize("places", [1, 2, 40])
def test_no_building_is_too_bare(write_row, things, places) -> None:
    graph = write_row([(name, min(x, places - 1.0)) for name, x in things], places)
    model = general_model([graph])
    z = embed_graph(model, GraphArrays.from_scene_graph(graph, model.labelspace))
    assert np.isfinite(z).all()
    assert z.shape == (places, 64)
    again = Model.from_bytes(model.to_bytes())
    assert again.hash == model.hash


def test_the_same_buildings_give_the_same_bytes_and_a_query_the_same_embedding(home) -> None:
    mapped, space, seen = home
    model = general_model([mapped], space)
    assert model.to_bytes() == general_model([mapped], space).to_bytes()
    extraction = model.encoder.extraction
    one = reach_all_batch(seen, len(space), extraction.radius_m, np.array([3]), extraction.bands)
    by_query = QueryEncoder(model.encoder).encode(one).embedding.numpy()
    np.testing.assert_allclose(by_query[0], embed_graph(model, seen)[3], atol=1e-5)


def test_of_many_places_some_are_taken_of_every_building(home, monkeypatch) -> None:
    mapped, space, seen = home
    assert 2 * mapped.n_places < MOST_PLACES
    monkeypatch.setattr("semloc_core.encoding.general.MOST_PLACES", 100)
    assert success(general_model([mapped, seen], space), mapped, seen) > 0.85


def test_none_is_refused() -> None:
    with pytest.raises(ModelError, match="at least one building"):
        general_model([])


def test_graphs_bring_their_own_classes() -> None:
    graph = SceneGraph.from_update(building_update())
    assert set(general_model([graph]).labelspace.classes) == {thing.class_ for thing in graph.objects.values()}
