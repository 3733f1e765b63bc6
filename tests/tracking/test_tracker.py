"""The filter inside the localiser: what resets it, what does not, and what is published."""

import msgspec
import numpy as np
import pytest
from small_building import building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import MapError
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap

BAYES = LocaliserConfig(filter="bayes", explain_rate_hz=0.0)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Two corridors that differ in their objects."""
    path = tmp_path_factory.mktemp("tracker") / "two.map"
    return make_map(path, make_model("rings"), a=building_update(seed=0), b=building_update(seed=1))


def belief(localiser: Localiser) -> np.ndarray:
    assert localiser._tracker is not None
    return localiser._tracker.filter.belief.copy()


def test_both_rankings_are_published(world):
    answer = Localiser(world, BAYES).update(building_update(query="p12")).matches
    plain = (
        Localiser(world, LocaliserConfig(explain_rate_hz=0.0, rerank="none"))
        .update(building_update(query="p12"))
        .matches
    )
    assert answer.raw_matches == plain.matches
    assert plain.raw_matches is None
    assert answer.matches[0].map == "a"
    assert abs(answer.matches[0].position[0] - 12) <= 4
    probabilities = [m.probability for m in answer.matches]
    assert probabilities == sorted(probabilities, reverse=True)
    z = world.embeddings[world.row("a", "p12")]
    for match in answer.matches:
        row = world.row(match.map, match.place)
        assert match.similarity == pytest.approx(float(world.embeddings[row] @ z), abs=1e-5)
    assert wire.decode(wire.encode(answer), wire.PlaceMatches).status == answer.status


def test_explaining_is_about_the_filters_answer(world):
    localiser = Localiser(world, LocaliserConfig(filter="bayes"))
    result = localiser.update(building_update(query="p12"))
    assert result.attributions is not None
    assert result.attributions.match_place == result.matches.matches[0].place


def test_asking_twice_counts_once(world):
    localiser = Localiser(world, BAYES)
    localiser.update(building_update(query="p12"))
    before = belief(localiser)
    localiser.locate()
    localiser.locate("p3")
    np.testing.assert_array_equal(belief(localiser), before)


def test_a_full_update_a_gap_and_a_restart_keep_the_belief(world):
    localiser = Localiser(world, BAYES)
    for i in range(12):
        localiser.update(delta(i, query=f"p{i + 5}") if i else building_update(query="p5"))
    walked = belief(localiser)
    localiser.update(building_update(query="p16", seq=40))
    assert np.abs(belief(localiser) - walked).max() < 0.3
    assert belief(localiser).argmax() == pytest.approx(walked.argmax(), abs=2)
    before = belief(localiser)
    assert localiser.update(delta(50, query="p17")).matches.status == "no_graph"
    np.testing.assert_array_equal(belief(localiser), before)
    localiser.update(building_update(query="p16", seq=0))
    assert np.abs(belief(localiser) - before).max() < 0.3


def test_odometry_is_the_way_walked_and_jitter_is_not(world):
    def step(seq: int, x: float, query: str = "p5"):
        odometry = wire.Odometry((x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        update = delta(seq, query=query) if seq else building_update(query=query)
        return msgspec.structs.replace(update, odometry=odometry)

    localiser = Localiser(world, BAYES)
    localiser.update(step(0, 0.0))
    localiser.update(step(1, 2.0))  # so that there is a past
    still = belief(localiser)
    for i in range(2, 30):
        localiser.update(step(i, 2.0 + 0.1 * (i % 2)))
    np.testing.assert_allclose(belief(localiser), still, rtol=1e-4, atol=1e-7)


def test_another_localiser_goes_on_with_the_belief_in_the_same_map(world):
    first, second = Localiser(world, BAYES), Localiser(world, LocaliserConfig(filter="bayes", top_n=3))
    for i in range(5):
        first.update(delta(i, query=f"p{i + 5}") if i else building_update(query="p5"))
    expected = belief(first)
    second.take_over(first)
    np.testing.assert_array_equal(belief(second), expected)


def test_an_empty_answer_stays_unknown(world):
    assert Localiser(world, BAYES).update(building_update(query=None)).matches.status == "unknown"
    assert Localiser(world, BAYES).update(building_update(objects=0)).matches.status == "unknown"


def test_a_map_without_scene_graphs_cannot_be_filtered(world):
    bare = LoadedMap(
        "bare", "", world.model, world.buildings, world.place_ids, world.positions, world.building_index,
        world.embeddings,
    )  # fmt: skip
    with pytest.raises(MapError, match="expected a map loaded from a file"):
        Localiser(bare, BAYES)


def test_where_nothing_fits_the_filter_alone_does_not_say_that_the_robot_is_in_the_map(world):
    """A robot that stays where no object fits the map: its belief gathers somewhere, and is worth nothing."""
    update = building_update(query="p12")
    high = [msgspec.structs.replace(o, position=(*o.position[:2], 30.0)) for o in update.objects]
    localiser = Localiser(world, BAYES)
    for seq in range(5):
        answer = localiser.update(msgspec.structs.replace(update, objects=high, seq=seq)).matches
        assert answer.status == "unknown"
    again = localiser.update(msgspec.structs.replace(update, seq=5)).matches
    assert again.matches[0].probability > 0.0


def test_what_verification_said_last_holds_while_it_is_silent(world):
    localiser = Localiser(world, BAYES)
    localiser.update(building_update(query="p12"))
    tracker = localiser._tracker
    assert tracker is not None
    before = tracker._in_map
    assert before > 0.0
    update = building_update(query="p12", seq=1)
    localiser.update(msgspec.structs.replace(update, objects=[], edges=update.edges[:29]))
    assert tracker._in_map == before
