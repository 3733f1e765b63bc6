"""SceneGraph.apply: all or nothing, order of operations, what it reports as changed."""

import copy
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from types import FrameType
from typing import Any

import msgspec
import pytest
from graph_strategies import any_updates, update, valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from semloc_core.errors import GraphError
from semloc_core.graph.geodesic import ball
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.wire import Object, Place, SceneGraphUpdate

ROW = [Place("a", (0.0, 0.0, 0.0)), Place("b", (3.0, 4.0, 0.0)), Place("c", (3.0, 4.0, 2.0))]
CHAIR = Object("x", "chair", (1.0, 1.0, 0.0))


def row_graph() -> SceneGraph:
    return SceneGraph.from_update(
        update(
            ROW,
            [CHAIR],
            [("a", "b"), ("c", "b"), ("x", "a")],
            full=True,
            sightings=[("c", "x")],
            query_place="a",
        )
    )


def test_a_full_update_becomes_the_graph() -> None:
    graph = row_graph()
    assert graph.neighbours == {"a": {"b": 5.0}, "b": {"a": 5.0, "c": 2.0}, "c": {"b": 2.0}}
    assert graph.parents == {"x": {"a"}}
    assert graph.children == {"a": {"x"}}
    assert graph.sightings == {"x": {"c"}}
    assert graph.sighted == {"c": {"x"}}
    assert graph.query_place == "a"
    assert graph.version == 1


@pytest.mark.parametrize("edge", [("x", "a"), ("a", "x")])
def test_a_parent_link_may_come_either_way_round(edge: tuple[str, str]) -> None:
    graph = SceneGraph.from_update(update(ROW[:1], [CHAIR], [edge], full=True))
    assert graph.parents == {"x": {"a"}}


def test_a_full_update_replaces_everything() -> None:
    graph = row_graph()
    change = graph.apply(update([ROW[1]], full=True))
    assert graph == replace(SceneGraph(), places={"b": ROW[1].position}, neighbours={"b": {}}, version=2)
    assert change == Change(True, frozenset("ac"), frozenset({("a", "b"), ("b", "c")}), frozenset("x"))


def test_a_repeated_full_update_changes_nothing() -> None:
    graph = row_graph()
    assert graph.apply(graph.to_update(0, 0, "map")) == Change(full=True)


def test_a_moved_place_changes_the_lengths_of_its_edges() -> None:
    graph = row_graph()
    change = graph.apply(update([Place("b", (0.0, 1.0, 0.0))]))
    assert graph.neighbours["a"]["b"] == graph.neighbours["b"]["a"] == 1.0
    assert change.places == {"b"}
    assert change.edges == {("a", "b"), ("b", "c")}


def test_an_upsert_keeps_edges_and_a_removal_does_not() -> None:
    graph = row_graph()
    assert graph.apply(update([ROW[1]], [CHAIR])) == Change()
    graph.apply(update(ROW[:1], [CHAIR], removed_nodes=["a", "x"]))
    assert graph.neighbours["a"] == {}
    assert graph.parents == {"x": set()}
    assert graph.children == graph.sightings == graph.sighted == {}


def test_removals_come_before_additions() -> None:
    graph = row_graph()
    change = graph.apply(update(edges=[("b", "a")], removed_edges=[("a", "b"), ("b", "c"), ("a", "x")]))
    assert graph.neighbours == {"a": {"b": 5.0}, "b": {"a": 5.0}, "c": {}}
    assert graph.parents == {"x": set()}
    assert graph.sightings == {"x": {"c"}}, "a removed edge is a parent link, never a sighting"
    assert change.objects == {"x"}


def test_removing_a_place_takes_what_hangs_on_it() -> None:
    graph = row_graph()
    change = graph.apply(update(removed_nodes=["a", "c"]))
    assert graph.places.keys() == {"b"}
    assert graph.neighbours == {"b": {}}
    assert graph.parents == {"x": set()}
    assert graph.children == graph.sightings == graph.sighted == {}
    assert graph.query_place is None
    assert change == Change(False, frozenset("ac"), frozenset({("a", "b"), ("b", "c")}), frozenset("x"))


def test_removing_what_is_not_there_is_no_error() -> None:
    assert row_graph().apply(update(removed_nodes=["zz"], removed_edges=[("zz", "a"), ("a", "c")])) == Change()


def test_a_node_may_change_its_kind_when_removed_in_the_same_update() -> None:
    graph = row_graph()
    graph.apply(update(objects=[Object("b", "box", (0.0, 0.0, 0.0))], removed_nodes=["b"], edges=[("b", "a")]))
    assert graph.neighbours == {"a": {}, "c": {}}
    assert graph.parents == {"x": {"a"}, "b": {"a"}}


NAN = float("nan")
BAD = {
    "self-loop": (update(edges=[("a", "a")]), "self-loop of 'a'"),
    "unknown end": (update(edges=[("a", "zz")]), "unknown 'zz'"),
    "two unknown ends": (update(edges=[("yy", "zz")]), "unknown 'yy'"),
    "unknown end of an object's edge": (update(edges=[("x", "zz")]), "unknown 'zz'"),
    "edge to a node removed here": (update(edges=[("a", "b")], removed_nodes=["b"]), "unknown 'b'"),
    "object-object edge": (
        update(objects=[Object("y", "box", (0.0,) * 3)], edges=[("x", "y")]),
        "objects 'x' and 'y'",
    ),
    "place becomes object": (update(objects=[Object("a", "box", (0.0,) * 3)]), "'a' to stay a place"),
    "object becomes place": (update([Place("x", (0.0,) * 3)]), "'x' to stay an object"),
    "place twice": (update([ROW[0], ROW[0]]), "got 'a' 2 times"),
    "object twice": (update(objects=[CHAIR, CHAIR]), "got 'x' 2 times"),
    "one id, two kinds": (
        update([Place("n", (0.0,) * 3)], [Object("n", "box", (0.0,) * 3)]),
        "got 'n' 2 times",
    ),
    "NaN": (update([Place("n", (0.0, NAN, 0.0))]), "position within ±1e+09 m"),
    "infinity": (update(objects=[Object("n", "box", (float("inf"), 0.0, 0.0))]), "position within"),
    "too far": (update([Place("n", (2e9, 0.0, 0.0))]), "position within"),
    "NaN size": (update(objects=[Object("n", "box", (0.0,) * 3, (1.0, NAN, 1.0))]), "finite size"),
    "labels of nothing": (update(objects=[Object("n", "box", (0.0,) * 3, None, {})]), "class to be the likeliest"),
    "NaN label": (update(objects=[Object("n", "box", (0.0,) * 3, None, {"box": NAN})]), "probabilities in (0, 1]"),
    "labels of more than one": (
        update(objects=[Object("n", "box", (0.0,) * 3, None, {"box": 0.7, "bed": 0.6})]),
        "at most 1 (got 1.3 for 'n')",
    ),
    "sighting of a place": (update(sightings=[("a", "b")]), "sighting [place, object]"),
    "sighting the wrong way round": (update(sightings=[("x", "a")]), "sighting [place, object]"),
    "sighting of nothing": (update(sightings=[("a", "zz")]), "sighting [place, object]"),
    "unknown query place": (update(query_place="zz"), "query_place to be a place of the graph (got 'zz', unknown)"),
    "query at an object": (update(query_place="x"), "got 'x'"),
    "query place removed here": (update(query_place="a", removed_nodes=["a"]), "got 'a'"),
    "full, edge to a node of the graph before": (
        update([ROW[0]], edges=[("a", "b")], full=True),
        "unknown 'b'",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_updates_are_refused_whole_with_one_line(name: str) -> None:
    bad, words = BAD[name]
    graph = row_graph()
    before = copy.deepcopy(graph)
    good_part = msgspec.structs.replace(bad, places=[*bad.places, Place("new", (9.0, 9.0, 9.0))])
    with pytest.raises(GraphError) as error:
        graph.apply(good_part)
    assert words in str(error.value)
    assert str(error.value).startswith("expected ")
    assert "\n" not in str(error.value)
    assert graph == before


@given(st.lists(any_updates(), max_size=8))
@settings(max_examples=80)
def test_a_refused_update_leaves_no_trace(updates: list[SceneGraphUpdate]) -> None:
    graph = SceneGraph()
    for each in updates:
        before = copy.deepcopy(graph)
        try:
            graph.apply(each)
        except GraphError:
            assert graph == before
            assert repr(graph) == repr(before)
        else:
            assert graph.version == before.version + 1
            assert graph.query_place == each.query_place


def content(graph: SceneGraph) -> SceneGraph:
    return replace(graph, version=0)


class PlainGraph:
    """The reference: sets of what is there, rebuilt without any care for cost."""

    def __init__(self) -> None:
        self.nodes: dict[str, Place | Object] = {}
        self.edges: set[frozenset[str]] = set()
        self.sightings: set[tuple[str, str]] = set()

    def apply(self, u: SceneGraphUpdate) -> None:
        if u.full:
            self.nodes, self.edges, self.sightings = {}, set(), set()
        else:
            self.edges -= {frozenset(e) for e in u.removed_edges}
            gone = set(u.removed_nodes)
            self.nodes = {k: v for k, v in self.nodes.items() if k not in gone}
            self.edges = {e for e in self.edges if not e & gone}
            self.sightings = {s for s in self.sightings if not set(s) & gone}
        self.nodes |= {n.id: n for n in (*u.places, *u.objects)}
        self.edges |= {frozenset(e) for e in u.edges}
        self.sightings |= set(u.sightings)

    def to_update(self, query_place: str | None) -> SceneGraphUpdate:
        places = [n for n in self.nodes.values() if isinstance(n, Place)]
        objects = [n for n in self.nodes.values() if isinstance(n, Object)]
        pairs = [(a, b) for a, b in map(tuple, self.edges)]
        return update(places, objects, pairs, full=True, query_place=query_place, sightings=list(self.sightings))


class AppliedEqualsRebuilt(RuleBasedStateMachine):
    """Any sequence of updates leaves the graph that a full update of the same content makes."""

    def __init__(self) -> None:
        super().__init__()
        self.graph = SceneGraph()
        self.plain = PlainGraph()

    @rule(data=st.data())
    def apply(self, data: st.DataObject) -> None:
        u = data.draw(valid_updates(self.graph))
        before = copy.deepcopy(self.graph)
        change = self.graph.apply(u)
        self.plain.apply(u)
        self.check_change(before, change)

    def check_change(self, before: SceneGraph, change: Change) -> None:
        """Whatever the change does not name is as it was."""
        after = self.graph
        for place in (before.places.keys() | after.places.keys()) - change.places:
            assert before.places.get(place) == after.places.get(place)
        for thing in (before.objects.keys() | after.objects.keys()) - change.objects:
            assert before.objects.get(thing) == after.objects.get(thing)
            assert before.parents.get(thing) == after.parents.get(thing)
            assert before.sightings.get(thing) == after.sightings.get(thing)
        for a in before.places.keys() | after.places.keys():
            for b in before.neighbours.get(a, {}).keys() | after.neighbours.get(a, {}).keys():
                old, new = before.neighbours.get(a, {}).get(b), after.neighbours.get(a, {}).get(b)
                assert old == new or (min(a, b), max(a, b)) in change.edges

    @invariant()
    def equals_the_graph_made_at_once(self) -> None:
        rebuilt = SceneGraph.from_update(self.plain.to_update(self.graph.query_place))
        assert content(self.graph) == content(rebuilt)

    @invariant()
    def the_index_finds_the_same_distances(self) -> None:
        slots = self.graph.index.slots
        assert slots.keys() == self.graph.places.keys()
        for place in self.graph.places:
            distances = self.graph.index.distances(place, 3.0)
            within = {other: distances[slot] for other, slot in slots.items() if distances[slot] <= 3.0}
            assert within == ball(self.graph.neighbours, place, 3.0)

    @invariant()
    def its_own_full_update_makes_it_again(self) -> None:
        message = self.graph.to_update(3, 7, "map")
        again = SceneGraph.from_update(message)
        assert content(again) == content(self.graph)
        assert again.to_update(3, 7, "map") == message


AppliedEqualsRebuilt.TestCase.settings = settings(max_examples=25, stateful_step_count=10)
test_applied_equals_rebuilt = AppliedEqualsRebuilt.TestCase


def test_to_update_is_canonical_and_names_the_query_place() -> None:
    message = row_graph().to_update(3, 7, "map")
    assert [p.id for p in message.places] == ["a", "b", "c"]
    assert message.edges == [("a", "b"), ("b", "c"), ("a", "x")]
    assert (message.seq, message.stamp_ns, message.frame_id, message.full) == (3, 7, "map", True)
    assert message.query_place == "a"
    assert row_graph().to_update(3, 7, "map", query_place="c").query_place == "c"


def test_a_delta_costs_the_same_in_a_large_graph() -> None:
    def cost(size: int) -> tuple[int, int]:
        """Operations of the interpreter, and the most bytes held besides the graph."""
        places = [Place(f"{i:06}", (float(i), 0.0, 0.0)) for i in range(size)]
        edges = [(a.id, b.id) for a, b in pairwise(places)]
        graph = SceneGraph.from_update(update(places, edges=edges, full=True))
        delta = update([Place("new", (0.0, 1.0, 0.0))], edges=[("new", "000000")], query_place="000001")
        removal = update(removed_nodes=["new"])
        operations = 0

        def count(frame: FrameType, event: str, _: object) -> Callable[..., Any]:
            nonlocal operations
            frame.f_trace_opcodes = True
            operations += event == "opcode"
            return count

        before = sys.gettrace()
        sys.settrace(count)
        try:
            graph.apply(delta)
            graph.apply(removal)
        finally:
            sys.settrace(before)
        tracemalloc.start()
        try:
            graph.apply(delta)
            graph.apply(removal)
            return operations, tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    (few, _), (many, held) = cost(20), cost(20_000)
    assert few == many > 100
    assert held < 50_000  # a copy of the ids alone is more


def test_the_index_of_a_graph_that_churns_does_not_grow() -> None:
    graph = row_graph()
    for i in range(50):
        new = f"new{i}"
        graph.apply(update([Place(new, (1.0, 1.0, 0.0))], edges=[(new, "a")], removed_nodes=[f"new{i - 1}"]))
        assert len(graph.index.distances("a", 9.0)) <= 4 + 1
