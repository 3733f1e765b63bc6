"""Deltas out of whole graphs: the receiver must end with the source's graph, whatever changed in between."""

from graph_strategies import valid_updates
from hypothesis import given
from hypothesis import strategies as st
from small_building import building_update

from semloc_core import wire
from semloc_core.graph.changes.delta import GraphDeltas, delta
from semloc_core.graph.changes.stream import Outcome, UpdateStream
from semloc_core.graph.scene_graph import SceneGraph

graphs = valid_updates(full=True).map(SceneGraph.from_update)


def content(graph):
    """A graph as one comparable thing, whatever way it came to be."""
    return graph.to_update(0, 0, "map")


@given(graphs, graphs)
def test_the_delta_makes_the_other_graph(before, after):
    receiver = SceneGraph()
    receiver.apply(before.to_update(0, 0, "map"))
    message = delta(before, after, 1, 0, "map", after.query_place)
    receiver.apply(wire.decode_update(wire.encode(message)))
    assert content(receiver) == content(after)


@given(st.lists(graphs, min_size=1, max_size=5), st.lists(st.booleans(), min_size=5, max_size=5))
def test_a_stream_of_graphs_arrives(sources, fulls):
    deltas, stream = GraphDeltas(), UpdateStream()
    for source, full in zip(sources, fulls, strict=False):
        outcome, _ = stream.apply(deltas.update(source, 0, "map", source.query_place, full=full))
        assert outcome is Outcome.APPLIED
        assert content(stream.graph) == content(source)


def test_a_graph_that_stays_as_it_is_costs_nothing():
    graph = SceneGraph.from_update(building_update())
    message = delta(graph, graph, 1, 0, "map", "p3")
    assert message.query_place == "p3"
    parts = (message.places, message.objects, message.edges, message.sightings, message.removed_nodes)
    assert not any(parts)
    assert message.removed_edges == []
