"""What is kept between updates gives the batches that extraction from nothing gives, whatever came in between."""

from __future__ import annotations

import pytest
import torch
from graph_strategies import update, valid_updates
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from semloc_core.encoding.place_graph import extract
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.encoding.surroundings import Surroundings
from semloc_core.errors import GraphError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.wire import Object, Place

SPACE = Labelspace("test", ("chair", "couch"))  # not all classes that the updates have
TENSORS = ("features", "edge_index", "edge_length", "is_object", "graph", "free_space")
EGO = Extraction("ego", 3, 2.0)
REACH = Extraction("reach", 1, 5.0, ((0.0, 1.0), (3.0, 2.0)))


class Kept(RuleBasedStateMachine):
    """One graph under any updates; every place is asked for after each."""

    extraction: Extraction

    def __init__(self) -> None:
        super().__init__()
        self.graph = SceneGraph()
        self.kept = Surroundings(self.graph, SPACE, self.extraction)

    @rule(data=st.data())
    def apply(self, data: st.DataObject) -> None:
        self.kept.update(self.graph.apply(data.draw(valid_updates(self.graph))))

    @invariant()
    def equals_extraction_from_nothing(self) -> None:
        fresh = SceneGraph.from_update(self.graph.to_update(0, 0, "map"))
        visibility = Visibility(fresh, self.extraction.visibility_m)
        for place in sorted(fresh.places):
            ours, anew = self.kept.batch(place), extract(fresh, visibility, SPACE, [place], self.extraction)
            for name in TENSORS:
                a, b = getattr(ours, name), getattr(anew, name)
                assert (a is None and b is None) or torch.equal(a, b), name
            assert ours.node_ids == anew.node_ids
            assert (ours.nodes_within, ours.edges_within) == (anew.nodes_within, anew.edges_within)
            assert (ours.kinds is None) == (anew.kinds is None)
            assert ours.kinds is None or anew.kinds is None or (ours.kinds == anew.kinds).all()


@pytest.mark.parametrize("extraction", [EGO, REACH], ids=["ego", "reach"])
def test_what_is_kept_is_what_is_there(extraction: Extraction) -> None:
    machine = type("Machine", (Kept,), {"extraction": extraction})
    run_state_machine_as_test(machine, settings=settings(max_examples=30, stateful_step_count=12))


@pytest.mark.parametrize("extraction", [EGO, REACH], ids=["ego", "reach"])
def test_a_place_that_is_not_there_is_refused(extraction: Extraction) -> None:
    with pytest.raises(GraphError, match=r"expected a place of the graph \(got 'p'\)"):
        Surroundings(SceneGraph(), SPACE, extraction).batch("p")


def test_an_id_may_come_back_as_another_kind_of_node() -> None:
    graph = SceneGraph()
    kept = Surroundings(graph, SPACE, EGO)
    here, there = Place("p", (0.0, 0.0, 0.0)), Place("x", (1.0, 0.0, 0.0))
    kept.update(graph.apply(update([here], [Object("x", "chair", (1.0, 0.0, 0.0))], [("p", "x")], full=True)))
    assert kept.batch("p").is_object.tolist() == [False, True]
    kept.update(graph.apply(update([there], edges=[("p", "x")], removed_nodes=["x"])))
    assert kept.batch("p").is_object.tolist() == [False, False]
    kept.update(graph.apply(update(objects=[Object("x", "box", (1.0, 0.0, 0.0))], removed_nodes=["x"])))
    assert kept.batch("p").node_ids == ("p",)
