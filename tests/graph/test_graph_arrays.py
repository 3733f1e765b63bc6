"""GraphArrays: canonical, checked, and back to an online graph."""

import random
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from graph_strategies import update, valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import Object, Place, SceneGraphUpdate

LABELS = Labelspace("test", ("chair", "couch", "box"))


def arrays() -> GraphArrays:
    places = [Place("p10", (3.0, 4.0, 0.0)), Place("p2", (0.0,) * 3), Place("p1", (0.0, 0.0, 2.0))]
    objects = [
        Object("z", "unheard-of", (1.0,) * 3),
        Object("a", "couch", (2.0,) * 3),
        Object("b", "chair", (3.0,) * 3),
    ]
    edges = [("p2", "p10"), ("p2", "p1"), ("p10", "z"), ("p2", "a"), ("p1", "a")]
    message = update(places, objects, edges, full=True, sightings=[("p2", "b"), ("p1", "z")])
    return GraphArrays.from_scene_graph(SceneGraph.from_update(message), LABELS, "flat")


def assert_equal(a: GraphArrays, b: GraphArrays) -> None:
    for name, value in vars(a).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, getattr(b, name), err_msg=name)
        else:
            assert value == getattr(b, name), name


def test_ids_are_sorted_and_indices_follow_them() -> None:
    a = arrays()
    assert (a.name, a.place_ids, a.object_ids) == ("flat", ("p1", "p10", "p2"), ("a", "b", "z"))
    assert a.place_positions.tolist() == [[0.0, 0.0, 2.0], [3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]
    assert a.object_classes.tolist() == [1, 0, -1]
    assert a.place_edges.T.tolist() == [[0, 2], [1, 2]]
    assert a.edge_lengths().tolist() == [2.0, 5.0]
    assert a.object_parents.T.tolist() == [[0, 0], [0, 2], [2, 1]]
    assert a.sightings.T.tolist() == [[0, 2], [2, 1]]


def test_objects_can_be_left_out() -> None:
    a = arrays().with_objects(np.array([False, True, True]))
    assert a.object_ids == ("b", "z")
    assert a.object_classes.tolist() == [0, -1]
    assert a.object_parents.T.tolist() == [[1, 1]]
    assert a.sightings.T.tolist() == [[0, 1], [2, 0]]
    none = a.with_objects(np.zeros(2, dtype=bool))
    assert none.n_objects == 0
    assert none.object_parents.shape == none.sightings.shape == (2, 0)


def test_an_empty_graph_has_arrays_too() -> None:
    a = GraphArrays.from_scene_graph(SceneGraph(), LABELS)
    assert (a.n_places, a.n_objects) == (0, 0)
    assert a.edge_lengths().shape == (0,)
    assert a.to_scene_graph(LABELS).places == {}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("place_positions", np.zeros((3, 2))),
        ("place_positions", np.zeros((3, 3), dtype=np.float32)),
        ("object_classes", np.zeros(2, dtype=np.int64)),
        ("place_edges", np.zeros((3, 1), dtype=np.int64)),
        ("object_parents", np.zeros(2, dtype=np.int64)),
        ("sightings", np.zeros((2, 1))),
    ],
)
def test_arrays_that_do_not_fit_are_refused_where_they_are_made(name: str, value: np.ndarray) -> None:
    with pytest.raises(AssertionError):
        replace(arrays(), **{name: value})


@given(valid_updates(full=True), st.randoms(use_true_random=False))
@settings(max_examples=50)
def test_the_order_of_a_message_does_not_matter(message: SceneGraphUpdate, order: random.Random) -> None:
    def shuffled(items: list) -> list:
        return order.sample(items, len(items))

    other = msgspec.structs.replace(
        message, **{n: shuffled(getattr(message, n)) for n in ("places", "objects", "edges", "sightings")}
    )
    a, b = (GraphArrays.from_scene_graph(SceneGraph.from_update(m), LABELS) for m in (message, other))
    assert_equal(a, b)


@given(valid_updates(full=True))
@settings(max_examples=50)
def test_there_and_back_is_the_same(message: SceneGraphUpdate) -> None:
    graph = SceneGraph.from_update(message)
    a = GraphArrays.from_scene_graph(graph, LABELS)
    back = a.to_scene_graph(LABELS)
    assert_equal(GraphArrays.from_scene_graph(back, LABELS), a)
    for name in ("places", "neighbours", "parents", "children", "sightings"):
        assert getattr(back, name) == getattr(graph, name)


def test_a_class_that_nobody_knows_stays_so() -> None:
    space = Labelspace("has it", ("chair", "couch", "unknown"))
    graph = arrays().to_scene_graph(space)
    assert graph.objects["a"].class_ == "couch"
    assert GraphArrays.from_scene_graph(graph, space).object_classes.tolist() == [1, 0, -1]


def test_what_objects_may_be_is_kept_and_comes_back() -> None:
    things = [
        Object("a", "couch", (0.0,) * 3, labels={"couch": 0.5, "chair": 0.25, "unheard-of": 0.25}),
        Object("b", "unknown", (1.0,) * 3),
        Object("c", "box", (2.0,) * 3, labels={"box": 0.25, "chair": 0.25}),
        Object("d", "box", (3.0,) * 3),
        Object("e", "unheard-of", (4.0,) * 3),
    ]
    a = GraphArrays.from_scene_graph(SceneGraph.of([], things, []), LABELS)
    assert a.object_labels is not None
    assert a.object_labels.tolist() == [
        [0.25, 0.5, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.25, 0.0, 0.25, 0.5],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0],
    ]
    assert a.object_classes.tolist() == [1, -1, 2, 2, -1]
    back = a.to_scene_graph(LABELS).objects
    assert [(back[i].class_, back[i].labels) for i in "abcde"] == [
        ("couch", {"chair": 0.25, "couch": 0.5}),
        ("unknown", None),
        ("box", {"chair": 0.25, "box": 0.25}),
        ("box", None),
        ("other", None),
    ]
    some = a.with_objects(np.array([True, False, False, True, False]))
    assert some.object_labels is not None
    assert some.object_labels.tolist() == [[0.25, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    assert arrays().object_labels is None, "each is of its class"
