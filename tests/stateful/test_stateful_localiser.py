"""Any sequence of updates: the localiser that took them in one by one equals one made from nothing.

Graph, visibility, ego graph and embedding are compared with a plain reference after every update; after every update
that is refused, nothing whatever may have changed.
"""

from __future__ import annotations

import os

import msgspec
import numpy as np
import pytest
import torch
from graph_strategies import CLASSES, any_updates, valid_updates
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from reference_graph import ReferenceGraph, makes_sense_alone
from small_building import building_update, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.encoding.place_graph import extract
from semloc_core.errors import GraphError, MessageError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.wire.codec import PlaceMatches, SceneGraphUpdate, decode, encode

SPACE = Labelspace("test", CLASSES[:3])
CLOSE = 1e-5
TENSORS = ("features", "edge_index", "edge_length", "is_object", "graph")


def state(localiser: Localiser) -> tuple[object, ...]:
    """All that an update can change; what was counted is not part of it."""
    graph, visibility, tracker = localiser.live.stream.graph, localiser.live.visibility, localiser._filter
    whole = None if graph is None else (encode(graph.to_update(0, 0, "")), graph.version, repr(graph.index._rows))
    seen = None if visibility is None else repr((visibility._objects, visibility._places, visibility._balls))
    belief = None if tracker is None else [(kept.walked, kept.chance.tobytes()) for kept in tracker._kept]
    live = localiser.live
    stamps = (live._seq, live._stamp_ns, live.odometry, localiser._explained_ns)
    return whole, seen, belief, live.stream._seq, stamps, dict(live.unknown_classes)


class Updates(RuleBasedStateMachine):
    """One localiser, one reference."""

    loaded: LoadedMap
    filter: str

    @initialize()
    def begin(self) -> None:
        self.localiser = Localiser(self.loaded, LocaliserConfig(explain_rate_hz=1000, filter=self.filter))
        self.model = self.loaded.model
        self.reference: ReferenceGraph | None = None
        self.seq = -1

    def feed(self, update: SceneGraphUpdate) -> None:
        """Take an update in on both sides."""
        expected, after = self.expected(update)
        text, before = encode(update), state(self.localiser)
        if expected == "rejected":
            with pytest.raises((MessageError, GraphError), match=r"^expected [^\n]* \(got[^\n]*\)$"):
                self.localiser.update(text)
            assert state(self.localiser) == before
            return
        result = self.localiser.update(text)
        assert result.outcome.value == expected
        if expected == "repeated":
            assert state(self.localiser) == before
            return
        self.reference = after
        if expected == "applied":
            self.seq = update.seq
        assert result.matches is not None
        decode(encode(result.matches), PlaceMatches)  # finite, and as the schema says

    def expected(self, update: SceneGraphUpdate) -> tuple[str, ReferenceGraph | None]:
        """What the contract says becomes of an update."""
        if not makes_sense_alone(update):
            return "rejected", None
        graph = self.reference
        if not update.full:
            if graph is None:
                return "waiting", None
            if update.seq <= self.seq:
                return "repeated", graph
            if update.seq > self.seq + 1:
                return "gap", None
        graph = graph or ReferenceGraph()
        return ("applied", graph.after(update)) if graph.fits(update) else ("rejected", graph)

    @rule(data=st.data())
    def full(self, data: st.DataObject) -> None:
        update = data.draw(valid_updates(full=True))
        self.feed(msgspec.structs.replace(update, seq=data.draw(st.integers(0, 9))))

    @rule(data=st.data())
    def delta(self, data: st.DataObject) -> None:
        self.feed(self.next_delta(data))

    @rule(data=st.data())
    def another_delta(self, data: st.DataObject) -> None:
        """The same again, so that deltas outnumber the rest."""
        self.feed(self.next_delta(data))

    @rule(data=st.data(), offset=st.sampled_from([-3, -1, 0, 2, 5]))
    def out_of_turn(self, data: st.DataObject, offset: int) -> None:
        self.feed(msgspec.structs.replace(self.next_delta(data), seq=max(0, self.seq + offset)))

    @rule(update=any_updates())
    def most_likely_wrong(self, update: SceneGraphUpdate) -> None:
        self.feed(msgspec.structs.replace(update, seq=self.seq + 1))

    @rule(
        data=st.data(), where=st.floats(0, 1), what=st.sampled_from([b"", b"}", b"NaN", b"1e999", b"\xff", b'"', b"-"])
    )
    def broken_text(self, data: st.DataObject, where: float, what: bytes) -> None:
        text = encode(self.next_delta(data))
        at = int(where * len(text))
        text = text[:at] + what + (text[at + 1 :] if what else b"")
        before = state(self.localiser)
        try:
            decode(text, SceneGraphUpdate)
        except MessageError:
            with pytest.raises(MessageError):
                self.localiser.update(text)
            assert state(self.localiser) == before

    @rule(data=st.data())
    def a_node_with_many_ties_goes(self, data: st.DataObject) -> None:
        graph = self.localiser.live.stream.graph
        tied = sorted({*graph.sighted, *graph.sightings, *graph.children}) if graph is not None else []
        if tied:
            gone = data.draw(st.sampled_from(tied))
            update = msgspec.structs.replace(ReferenceGraph().to_update([0]), full=False, seq=self.seq + 1)
            self.feed(msgspec.structs.replace(update, removed_nodes=[gone]))

    def next_delta(self, data: st.DataObject) -> SceneGraphUpdate:
        update = data.draw(valid_updates(self.localiser.live.stream.graph, full=False))
        return msgspec.structs.replace(update, seq=self.seq + 1)

    @invariant()
    def graph_is_the_reference(self) -> None:
        graph, reference = self.localiser.live.stream.graph, self.reference
        assert (graph is None) == (reference is None)
        if graph is None or reference is None:
            return
        assert graph.places == reference.places
        assert graph.objects == reference.objects
        assert {frozenset((a, b)) for a, row in graph.neighbours.items() for b in row} == reference.edges
        assert {(p, o) for o, row in graph.parents.items() for p in row} == reference.links
        assert {(p, o) for p, row in graph.children.items() for o in row} == reference.links
        assert {(p, o) for o, row in graph.sightings.items() for p in row} == reference.sightings
        assert {(p, o) for p, row in graph.sighted.items() for o in row} == reference.sightings
        assert graph.query_place == reference.query_place

    @invariant()
    def what_is_seen_and_said_is_as_if_made_from_nothing(self) -> None:
        graph, reference, kept = self.localiser.live.stream.graph, self.reference, self.localiser.live.visibility
        if graph is None or reference is None or kept is None or not reference.places:
            return
        extraction = self.model.encoder.extraction
        visible = reference.visible(kept.radius_m)
        found = {(p, o): metres for p in reference.places for o, metres in kept.objects_of(p).items()}
        assert found.keys() == visible.keys()
        assert all(abs(found[pair] - visible[pair]) < CLOSE for pair in found)

        fresh = SceneGraph.from_update(reference.to_update([graph.version % 7, 3, 1, 2]))
        places = sorted(reference.places)
        ours = extract(graph, kept, SPACE, places, extraction)
        anew_view = Visibility(fresh, kept.radius_m)
        anew = extract(fresh, anew_view, SPACE, places, extraction)
        assert ours.node_ids == anew.node_ids
        assert all(torch.equal(getattr(ours, name), getattr(anew, name)) for name in TENSORS)
        for place in places:  # what was kept from update to update
            alone, one = (
                self.localiser.live.surroundings.batch(place),
                extract(fresh, anew_view, SPACE, [place], extraction),
            )
            assert alone.node_ids == one.node_ids
            assert (alone.nodes_within, alone.edges_within) == (one.nodes_within, one.edges_within)
            assert all(torch.equal(getattr(alone, name), getattr(one, name)) for name in TENSORS)
        if extraction.kind == "ego":
            for number, place in enumerate(places):
                nodes = {id_ for id_, owner in zip(ours.node_ids, ours.graph.tolist(), strict=True) if owner == number}
                assert nodes == reference.surroundings(place, extraction.hops, kept.radius_m, set(SPACE.classes))
        with torch.inference_mode():
            embeddings = self.model.encoder.encode(ours).embedding.numpy()
        whole = embed_graph(self.model, GraphArrays.from_scene_graph(fresh, SPACE))
        assert np.abs(embeddings - whole).max() < CLOSE


@pytest.mark.parametrize(("encoder", "filter_"), [("paper", "none"), ("geodesic_attention", "bayes")])
def test_updates_in_any_order_lead_where_a_full_update_would(tmp_path, encoder, filter_):
    model = make_model(encoder, space=SPACE)
    machine = type("Machine", (Updates,), {"loaded": None, "filter": filter_})
    machine.loaded = make_map(tmp_path / "home.map", model, home=building_update(12, 8))
    long = int(os.environ.get("SEMLOC_SOAK", "0"))  # set by `make soak`: how many sequences, at random
    options = settings(max_examples=long or 15, stateful_step_count=25)
    run_state_machine_as_test(machine, settings=options)
