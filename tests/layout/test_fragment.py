"""What counts as the robot's surroundings must not hang on how the graph is held, named or ordered."""

import msgspec
import numpy as np

from semloc_core.layout import LayoutConfig, fragment_of_arrays, fragment_of_graph
from semloc_core.layout.fragment import CELL_M, thinned

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
