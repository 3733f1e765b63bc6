"""Maps and options change while a robot drives: nothing of its stream may get lost on the way."""

import pytest
from small_building import CLASSES, building_update, delta, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.graph.changes.stream import Outcome
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.localiser import Localiser


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """Maps of one building by encoders that see differently far, the last with a class less."""
    folder = tmp_path_factory.mktemp("maps")
    fewer = Labelspace("fewer", CLASSES[:-1])
    return [
        make_map(folder / "paper.map", make_model("paper"), home=building_update()),
        make_map(folder / "rings.map", make_model("rings"), home=building_update()),
        make_map(folder / "fewer.map", make_model("paper", space=fewer), home=building_update()),
    ]


@pytest.mark.parametrize(("before", "after"), [(0, 0), (0, 1), (1, 0), (0, 2), (2, 0)])
def test_the_next_delta_is_answered_as_if_the_map_had_always_been_there(maps, before, after):
    old, always = Localiser(maps[before]), Localiser(maps[after])
    for update in (building_update(), delta(1, query="p3", removed_nodes=["o1"])):
        old.update(update)
        always.update(update)
    new = Localiser(maps[after])
    new.take_over(old)
    result = new.update(delta(2, query="p12", removed_nodes=["o2"]))
    assert result.outcome is Outcome.APPLIED
    assert result.matches == always.update(delta(2, query="p12", removed_nodes=["o2"])).matches


def test_counts_and_throttle_go_on_and_unknown_classes_are_counted_anew(maps):
    config = LocaliserConfig(explain_rate_hz=1.0)
    old = Localiser(maps[0], config)
    assert old.update(building_update()).attributions is not None
    new = Localiser(maps[2], config)
    new.take_over(old)
    soon = new.update(delta(1, stamp_ns=1_100_000_000, query="p5"))
    assert soon.attributions is None
    assert new.live.stream.counts["applied"] == 2
    paintings = [o for o in new.live.stream.graph.objects.values() if o.class_ == CLASSES[-1]]
    assert new.live.unknown_classes == {CLASSES[-1]: len(paintings)}


def test_taking_over_before_there_is_a_graph(maps):
    new = Localiser(maps[1])
    new.take_over(Localiser(maps[0]))
    assert new.update(delta(1)).matches.status == "no_graph"
    assert new.update(building_update()).outcome is Outcome.APPLIED


def test_any_place_can_be_asked_about(maps):
    localiser = Localiser(maps[0])
    localiser.update(building_update(query="p5"))
    other = localiser.locate("p12")
    assert other.matches == Localiser(maps[0]).update(building_update(query="p12")).matches
    assert localiser.locate().query.place == "p5"
    unknown = localiser.locate("nowhere")
    assert unknown.matches.status == "unknown"
    assert "not in the graph" in unknown.query.reason
