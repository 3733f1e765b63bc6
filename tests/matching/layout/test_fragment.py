"""What counts as the robot's surroundings must not hang on how the graph is held, named or ordered."""

import msgspec
import numpy as np

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.matching.layout import LayoutConfig, fragment_of_arrays, fragment_of_graph
from semloc_core.matching.layout.fragment import CELL_M, thinned
from semloc_core.wire import Place

CONFIG = LayoutConfig()


def test_a_live_graph_and_a_frozen_one_have_the_same_surroundings(homes):
    maps, _, space = homes
    graph = maps[0].to_scene_graph(space)
    for place in range(0, maps[0].n_places, 29):
        live = fragment_of_graph(graph, space, maps[0].place_ids[place], CONFIG)
        frozen = fragment_of_arrays(maps[0], place, CONFIG)
        np.testing.assert_array_equal(live.objects, frozen.objects)
        np.testing.assert_array_equal(live.classes, frozen.classes)
        np.testing.assert_array_equal(live.places, frozen.places)
        assert live.object_ids == frozen.object_ids


def test_a_graph_that_grew_and_shrank_has_the_surroundings_of_one_made_at_once(homes):
    """What is kept between updates must not be seen in an answer: a replay from its middle says the same."""
    maps, _, space = homes
    whole = maps[0].to_scene_graph(space)
    ids, moved = maps[0].place_ids, maps[0].place_ids[3]
    x, y, z = whole.places[moved]
    update = whole.to_update(0, 0, "map")
    graph = SceneGraph()
    for first in range(0, len(ids), 50):  # in another order, and with places that go again
        some = [Place(i, whole.places[i]) for i in ids[::-1][first : first + 50]]
        graph.apply(delta(update, places=[*some, Place(f"gone{first}", (x, y, z + 0.1))]))
        assert len(fragment_of_graph(graph, space, some[0].id, CONFIG).places)
    graph.apply(delta(update, objects=update.objects, removed_nodes=[f"gone{i}" for i in range(0, len(ids), 50)]))
    graph.apply(delta(update, places=[Place(moved, (x + 0.3, y, z))]))
    at_once = delta(update, full=True, places=[*graph_places(graph)], objects=update.objects)
    fresh = SceneGraph.from_update(at_once)
    for place in ids[::17]:
        one, other = (fragment_of_graph(each, space, place, CONFIG) for each in (graph, fresh))
        np.testing.assert_array_equal(one.places, other.places)
        np.testing.assert_array_equal(one.objects, other.objects)
        assert one.object_ids == other.object_ids


def delta(update, full=False, **parts):
    none = {"places": [], "objects": [], "edges": [], "sightings": [], "removed_nodes": [], "removed_edges": []}
    return msgspec.structs.replace(update, full=full, query_place=None, **{**none, **parts})


def graph_places(graph):
    return [Place(key, at) for key, at in sorted(graph.places.items())]


def test_places_are_thinned_alike_in_any_order_and_however_far_away():
    rng = np.random.default_rng(0)
    places = np.round(rng.uniform(-6, 6, (400, 3)), 1)  # many of them as near the middle of a cell
    kept = thinned(places)
    np.testing.assert_array_equal(kept, thinned(places[rng.permutation(400)]))
    cells = np.floor(places / CELL_M)
    assert len(kept) == len(np.unique(cells, axis=0))
    # Cells are told apart by one number; where it is too small for them they are compared one by one.
    far = thinned(np.concatenate([places, [[1e9, 1e9, 0.0], [1e9, -1e9, 0.0]]]))
    assert len(far) == len(kept) + 2
    np.testing.assert_array_equal(far[far[:, 0] < 1e9], kept)


def test_objects_out_of_reach_on_other_floors_or_of_no_class_do_not_count(homes):
    fragment = fragment_of_arrays(homes[0][0], 0, msgspec.structs.replace(CONFIG, reach_m=5.0, floor_m=0.5))
    assert len(fragment.objects)
    assert (np.hypot(*fragment.objects[:, :2].T) <= 5.0).all()
    assert (np.abs(fragment.objects[:, 2]) <= 0.5).all()
    assert (fragment.classes >= 0).all()


def test_the_nearest_objects_are_kept_where_there_are_too_many(homes):
    every = fragment_of_arrays(homes[0][0], 0, CONFIG)
    some = fragment_of_arrays(homes[0][0], 0, msgspec.structs.replace(CONFIG, most_objects=3))
    assert some.object_ids == every.object_ids[:3]
    metres = np.linalg.norm(every.objects, axis=1)
    assert (np.diff(metres) >= -1e-6).all()


def test_closer_places_do_not_speak_louder():
    """A mapper that lays places ten times as dense says little more about the same floor."""
    x, y = np.meshgrid(np.arange(0, 8, 0.8), np.arange(0, 8, 0.8))
    coarse = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) + 0.4
    x, y = np.meshgrid(np.arange(0, 8, 0.1), np.arange(0, 8, 0.1))
    dense = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) + 0.05
    assert len(thinned(dense)) == len(thinned(coarse)) == 100
    assert CELL_M == 0.8
    assert thinned(np.zeros((0, 3))).shape == (0, 3)
