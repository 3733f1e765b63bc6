"""Visibility: walls count, sightings win, and what is kept up to date equals what is made from nothing."""

import numpy as np
import pytest
from graph_strategies import OBJECTS, PLACES, update, valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

import semloc_core.graph.geodesic
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.geodesic import ball, edge_length, edge_lengths, many_balls, repair
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.graph.visibility import Visibility, visible_pairs
from semloc_core.wire import Object, Place, SceneGraphUpdate

LABELS = Labelspace("test", ("chair", "couch", "box"))


def corridor(n: int = 6) -> SceneGraph:
    """Places a metre apart; object x at place 0, object y at place 5."""
    places = [Place(f"p{i}", (float(i), 0.0, 0.0)) for i in range(n)]
    edges = [(f"p{i}", f"p{i + 1}") for i in range(n - 1)]
    objects = [Object("x", "chair", (0.0, 0.0, 0.0)), Object("y", "box", (5.0, 0.0, 0.0))]
    return SceneGraph.from_update(update(places, objects, [*edges, ("p0", "x"), ("p5", "y")], full=True))


def rows(visibility: Visibility) -> dict[tuple[str, str], float]:
    """All pairs, read both ways, which must agree."""
    by_place = {(p, o): d for p in PLACES for o, d in visibility.objects_of(p).items()}
    by_object = {(p, o): d for o in (*OBJECTS, "x", "y") for p, d in visibility.places_of(o).items()}
    assert by_place == by_object
    return by_place


def test_distance_is_geodesic_and_the_radius_inclusive() -> None:
    visibility = Visibility(corridor(), 3.0)
    assert visibility.places_of("x") == {"p0": 0.0, "p1": 1.0, "p2": 2.0, "p3": 3.0}
    assert visibility.objects_of("p3") == {"x": 3.0, "y": 2.0}


def test_a_wall_hides_what_is_near_in_a_straight_line() -> None:
    places = [Place(n, p) for n, p in {"a": (0.0, 0.0, 0.0), "b": (0.0, 9.0, 0.0), "c": (1.0, 0.0, 0.0)}.items()]
    graph = SceneGraph.from_update(
        update(places, [Object("x", "chair", (0.0,) * 3)], [("a", "b"), ("b", "c"), ("a", "x")], full=True)
    )
    assert Visibility(graph, 5.0).places_of("x") == {"a": 0.0}


def test_the_nearest_of_several_parents_counts() -> None:
    graph = corridor()
    graph.apply(update(edges=[("p4", "x")]))
    assert Visibility(graph, 1.0).places_of("x") == {"p0": 0.0, "p1": 1.0, "p3": 1.0, "p4": 0.0, "p5": 1.0}


def test_sightings_win_and_one_out_of_reach_counts_as_the_radius() -> None:
    graph = corridor()
    graph.apply(update(sightings=[("p1", "x"), ("p5", "x")]))
    assert Visibility(graph, 3.0).places_of("x") == {"p1": 1.0, "p5": 3.0}


def test_an_object_without_parent_or_sighting_is_not_seen() -> None:
    graph = corridor()
    graph.apply(update(objects=[Object("z", "box", (0.0,) * 3)]))
    visibility = Visibility(graph, 3.0)
    assert visibility.places_of("z") == {}
    assert visibility.objects_of("nowhere") == {}


def test_update_names_the_places_whose_view_changed() -> None:
    graph = corridor()
    visibility = Visibility(graph, 2.0)
    assert visibility.update(graph.apply(update(removed_edges=[("p1", "p2")]))) == ({"p2"}, {"x"})
    assert visibility.update(graph.apply(update(edges=[("p1", "p2")]))) == ({"p2"}, {"x"})
    far = update([Place("p9", (0.0, 2.0, 0.0))], edges=[("p9", "p5")])
    assert visibility.update(graph.apply(far)) == (set(), set())
    recoloured = Object("y", "couch", (5.0, 0.0, 0.0))
    assert visibility.update(graph.apply(update(objects=[recoloured]))) == ({"p3", "p4", "p5"}, set())
    assert visibility.update(graph.apply(update(removed_nodes=["x"]))) == ({"p0", "p1", "p2"}, {"x"})
    assert visibility.update(graph.apply(graph.to_update(0, 0, "map"))) == (set(), set())


def test_an_update_far_from_all_objects_looks_at_no_ball(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = corridor(200)
    visibility = Visibility(graph, 3.0)

    def refuse(*_: object) -> None:
        raise AssertionError("a ball was computed again")

    monkeypatch.setattr(semloc_core.graph.visibility, "ball", refuse)
    monkeypatch.setattr(semloc_core.graph.visibility, "repair", refuse)
    visibility.update(graph.apply(update([Place("new", (150.0, 1.0, 0.0))], edges=[("new", "p150")])))
    with pytest.raises(AssertionError, match="again"):
        visibility.update(graph.apply(update([Place("other", (1.0, 1.0, 0.0))], edges=[("other", "p1")])))


def test_what_no_object_needs_is_forgotten() -> None:
    graph = corridor()
    visibility = Visibility(graph, 2.0)
    visibility.update(graph.apply(update(removed_edges=[("p0", "x")], removed_nodes=["y"])))
    assert visibility._balls == visibility._reached == visibility._places == visibility._objects == {}


class KeptEqualsRebuilt(RuleBasedStateMachine):
    """After any updates, also several at once, the kept visibility is that of a new one."""

    def __init__(self) -> None:
        super().__init__()
        self.graph = SceneGraph()
        self.visibility = Visibility(self.graph, 2.0)
        self.waiting: list[Change] = []

    @rule(data=st.data())
    def apply(self, data: st.DataObject) -> None:
        u = data.draw(valid_updates(self.graph))
        self.waiting.append(self.graph.apply(u))

    @precondition(lambda self: self.waiting)
    @rule()
    def take_in(self) -> None:
        before = rows(self.visibility)
        views = [self.visibility.update(change) for change in self.waiting]
        self.waiting.clear()
        after = rows(self.visibility)
        differ = {pair for pair in before.keys() | after.keys() if before.get(pair) != after.get(pair)}
        assert {p for p, _ in differ} <= frozenset().union(*[view.places for view in views])
        assert {o for _, o in differ} <= frozenset().union(*[view.objects for view in views])

    @precondition(lambda self: not self.waiting)
    @invariant()
    def equals_one_made_from_nothing(self) -> None:
        new = Visibility(self.graph, 2.0)
        assert rows(self.visibility) == rows(new)
        for name in ("_balls", "_reached", "_sources", "_places", "_objects"):
            assert getattr(self.visibility, name) == getattr(new, name), name


KeptEqualsRebuilt.TestCase.settings = settings(max_examples=30, stateful_step_count=15)
test_kept_equals_rebuilt = KeptEqualsRebuilt.TestCase


@given(valid_updates(full=True), st.sampled_from([0.0, 0.1, 1.0, 2.0, 2.1, 9.0]))
@settings(max_examples=80)
def test_the_batch_version_is_equal_bit_by_bit(message: SceneGraphUpdate, radius_m: float) -> None:
    graph = SceneGraph.from_update(message)
    arrays = GraphArrays.from_scene_graph(graph, LABELS)
    pairs, distances = visible_pairs(arrays, radius_m)
    assert pairs.dtype == np.int64
    named = [(arrays.place_ids[p], arrays.object_ids[o]) for p, o in pairs.T]
    assert named == sorted(set(named))
    assert dict(zip(named, distances.tolist(), strict=True)) == rows(Visibility(graph, radius_m))


def test_the_batch_version_works_in_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    arrays = GraphArrays.from_scene_graph(corridor(), LABELS)
    whole = visible_pairs(arrays, 3.0)
    monkeypatch.setattr(semloc_core.graph.geodesic, "_CELLS_AT_ONCE", 1)
    pairs, distances = visible_pairs(arrays, 3.0)
    np.testing.assert_array_equal(pairs, whole[0])
    np.testing.assert_array_equal(distances, whole[1])


@pytest.mark.parametrize("kept", [[], ["p0"]])
def test_the_batch_version_of_hardly_anything(kept: list[str]) -> None:
    graph = SceneGraph.from_update(update([Place(p, (0.0,) * 3) for p in kept], full=True))
    pairs, distances = visible_pairs(GraphArrays.from_scene_graph(graph, LABELS), 3.0)
    assert pairs.shape == (2, 0)
    assert distances.shape == (0,)


points = st.tuples(*[st.floats(-50, 50)] * 3)


@given(st.lists(points, min_size=6, max_size=6), st.lists(st.tuples(*[st.integers(0, 5)] * 2), max_size=9))
def test_distances_are_the_same_bits_from_either_end_and_from_scipy(
    positions: list[tuple[float, float, float]], pairs: list[tuple[int, int]]
) -> None:
    edges = np.array(sorted({(min(e), max(e)) for e in pairs if e[0] != e[1]}), dtype=np.int64).reshape(-1, 2).T
    lengths = edge_lengths(np.array(positions), edges)
    assert lengths.tolist() == [edge_length(positions[a], positions[b]) for a, b in edges.T]
    neighbours: dict[str, dict[str, float]] = {str(i): {} for i in range(6)}
    for (a, b), length in zip(edges.T, lengths.tolist(), strict=True):
        neighbours[str(a)][str(b)] = neighbours[str(b)][str(a)] = length
    table = {(s, p): d for s in neighbours for p, d in ball(neighbours, s, 60.0).items()}
    assert table == {(s, p): d for (p, s), d in table.items()}
    source, place, distance = many_balls(6, edges, lengths, np.arange(6), 60.0)
    assert table == {(str(s), str(p)): d for s, p, d in zip(source, place, distance.tolist(), strict=True)}


@given(st.data())
@settings(max_examples=150)
def test_a_repaired_ball_is_a_new_one(data: st.DataObject) -> None:
    lengths = st.sampled_from([0.0, 1.0, 1.0, 2.0])
    pair = st.tuples(st.integers(0, 7), st.integers(0, 7)).filter(lambda e: e[0] < e[1])
    edges = data.draw(st.dictionaries(pair, lengths, max_size=14))
    later = {e: w for e, w in edges.items() if data.draw(st.integers(0, 3))}
    later |= data.draw(st.dictionaries(pair, lengths, max_size=3))

    def adjacency(of: dict[tuple[int, int], float]) -> dict[str, dict[str, float]]:
        table: dict[str, dict[str, float]] = {str(i): {} for i in range(8)}
        for (a, b), w in of.items():
            table[str(a)][str(b)] = table[str(b)][str(a)] = w
        return table

    distances = ball(adjacency(edges), "0", 4.0)
    old = dict(distances)
    touched = {str(n) for e in edges.keys() | later.keys() if edges.get(e) != later.get(e) for n in e}
    moved = repair(distances, adjacency(later), "0", 4.0, touched)
    assert distances == ball(adjacency(later), "0", 4.0)
    assert moved == {p for p in old.keys() | distances.keys() if old.get(p) != distances.get(p)}
