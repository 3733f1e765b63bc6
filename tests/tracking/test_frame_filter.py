"""The filter over where the run's frame lies: what the past says, what it may not say, and what makes it forgotten."""

from copy import deepcopy
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from small_building import building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import ConfigError, MapError
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Answers
from semloc_core.matching.layout.answers import shipped_calibration
from semloc_core.tracking import FrameFilter
from semloc_core.tracking.frame_filter import ANYWHERE, APART_M, KEPT, WENT_ON, WRONG

BAYES = LocaliserConfig(filter="bayes", explain_rate_hz=0.0)
HOMES = ("hall", "tower")


def answers(*said: tuple[str, tuple[float, float], float, float]) -> Answers:
    """Answers, best first: building, where it has the robot, its heading in degrees, and P(right)."""
    chance = np.array([p for *_, p in said])
    return Answers(
        pose=np.array([(*at, 0.0) for _, at, _, _ in said]),
        heading=np.radians([degrees for _, _, degrees, _ in said]),
        building=np.array([HOMES.index(name) for name, *_ in said]),
        storey=np.zeros(len(said), dtype=np.int64),
        chance=chance,
        most=float(chance[0]),
        n_objects=9,
        calibration=shipped_calibration(),
    )


def believe(past: FrameFilter, said: Answers, x: float, walked: float | None = None, drift: float = 0.0) -> list[float]:
    asked = deepcopy(past)  # what is only asked about is not taken in
    by = asked.observe(said, HOMES, np.array([x, 0.0, 0.0]), x if walked is None else walked, drift)
    return (by * said.likely()).tolist()


def observe(past: FrameFilter, said: Answers, x: float, walked: float | None = None, drift: float = 0.0) -> None:
    past.observe(said, HOMES, np.array([x, 0.0, 0.0]), x if walked is None else walked, drift)


TWINS = answers(("hall", (20.0, 0.0), 0.0, 0.49), ("hall", (60.0, 0.0), 0.0, 0.49))
"""Two rooms alike, 40 m apart, seen from 20 m into the run."""


def test_the_first_answer_is_what_it_says():
    """A filter that knows nothing may change nothing: not the probabilities' sum, not their order."""
    assert believe(FrameFilter(), TWINS, 0.0) == pytest.approx([0.49, 0.49])


def test_a_room_that_was_recognised_before_tells_twins_apart():
    past = FrameFilter()
    observe(past, answers(("hall", (0.0, 0.0), 0.0, 0.95)), 0.0)
    right, other = believe(past, TWINS, 20.0)
    # By hand: two frames and all others, by Bayes' rule after the first answer, and then perhaps a new one.
    prior = np.array([ANYWHERE, ANYWHERE, 1 - 2 * ANYWHERE])
    then = prior * (np.array([0.95 / ANYWHERE, 0.05, 0.05]) * (1 - WRONG) + WRONG)
    now = WENT_ON * then / then.sum() + (1 - WENT_ON) * prior
    after = now * np.array([0.49 / ANYWHERE, 0.49 / ANYWHERE, 0.02])
    assert [right, other] == pytest.approx((after / after.sum())[:2].tolist(), abs=1e-9)
    assert right > 0.8


def test_a_heading_counts_as_a_place_does():
    """By the twin that is turned round, the robot was 20 m off where it was recognised."""
    past = FrameFilter()
    observe(past, answers(("hall", (0.0, 0.0), 0.0, 0.98)), 0.0)
    turned = answers(("hall", (20.0, 0.0), 180.0, 0.49), ("hall", (20.0, 0.0), 0.0, 0.48))
    assert believe(past, turned, 20.0)[1] > 0.8


def test_what_the_present_knows_too_is_not_counted_twice():
    """Answers from within the reach of the test rest on the same objects."""
    past = FrameFilter()
    observe(past, answers(("hall", (0.0, 0.0), 0.0, 0.98)), 0.0)
    assert believe(past, TWINS, APART_M - 0.1) == pytest.approx([0.49, 0.49])


MOST = (WENT_ON + (1 - WENT_ON) * ANYWHERE) / ((1 - WENT_ON) * ANYWHERE)
"""By so much, as a factor, the past speaks at most for one answer against another."""


def test_another_buildings_past_speaks_against_and_only_so_much():
    past = FrameFilter()
    for i in range(KEPT):
        observe(past, answers(("tower", (APART_M * i, 0.0), 0.0, 0.99)), APART_M * i)
    x = APART_M * KEPT
    said = answers(("hall", (0.0, 0.0), 0.0, 0.6), ("tower", (x, 0.0), 0.0, 0.3))
    carried, stayed = believe(past, said, x)
    assert 0.3 / 0.6 < stayed / carried <= MOST * 0.3 / 0.6


def carried(weak: tuple[float, float]) -> list[bool]:
    """Whether a robot that was carried into a twin says so, metre by metre, sure of where it was before."""
    past = FrameFilter()
    for x in range(100):
        observe(past, answers(("tower", (float(x), 0.0), 0.0, 0.99)), float(x))
    found = []
    for x in range(100, 100 + 5 * int(APART_M)):
        at = (float(x), 0.0)
        said = answers(("hall", at, 0.0, weak[0]), ("tower", at, 0.0, weak[1]))
        twin, before = believe(past, said, float(x))
        found.append(twin > before)
        observe(past, said, float(x))
    return found


def test_a_robot_carried_into_a_twin_is_believed_at_once_where_it_is_sure():
    assert all(carried((0.9, 0.05)))


def test_a_robot_carried_into_a_twin_is_believed_on_weak_evidence_that_lasts():
    """Twice as likely there as where it was: the past gives way within the reach of two answers, and for good."""
    found = carried((0.6, 0.3))
    assert not found[0]
    assert all(found[2 * int(APART_M) + 1 :])


def test_a_robot_that_was_not_carried_goes_on_gaining_where_rooms_are_alike():
    """Room after room with a twin that is as likely, each time elsewhere: only the right one is where it was before."""
    past, gained = FrameFilter(), []
    for i in range(12):
        x = APART_M * i
        said = answers(("hall", (x, 0.0), 0.0, 0.48), ("hall", (900.0 - 7 * x, 0.0), 0.0, 0.48))
        gained.append(believe(past, said, x)[0])
        observe(past, said, x)
    assert gained[0] == pytest.approx(0.48)
    assert gained[1] > 0.6
    assert all(after >= before - 1e-9 for before, after in pairwise(gained))


def test_an_answer_that_was_sure_and_wrong_does_not_outlive_the_others():
    """Seen in a twin once, between rooms that were told apart: it counts for less than with no other to deny it."""
    wrong = answers(("tower", (40.0, 0.0), 0.0, 0.97), ("hall", (12.0, 0.0), 0.0, 0.02))
    after = answers(("tower", (64.0, 0.0), 0.0, 0.48), ("hall", (36.0, 0.0), 0.0, 0.48))
    alone, denied = FrameFilter(), FrameFilter()
    for past in (alone, denied):
        observe(past, wrong, 12.0)
    observe(denied, answers(("hall", (24.0, 0.0), 0.0, 0.9), ("tower", (52.0, 0.0), 0.0, 0.05)), 24.0)
    assert believe(alone, after, 36.0)[0] > 0.6
    assert believe(denied, after, 36.0)[1] > 0.6


def test_a_frame_that_drifts_may_be_further_off():
    """After 20 m at a usual drift (0.5° a root metre) the robot's old place is off by metres, and still the same."""
    past = FrameFilter()
    observe(past, answers(("hall", (0.0, 0.0), 0.0, 0.98)), 0.0, walked=0.0)
    off = answers(("hall", (20.0, 3.6), 0.0, 0.49), ("hall", (60.0, 0.0), 0.0, 0.49))
    assert believe(past, off, 20.0, walked=40.0, drift=1.0)[0] > 0.8
    assert believe(past, off, 20.0, walked=40.0, drift=0.0)[0] == pytest.approx(believe(past, off, 20.0, drift=0.0)[1])


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Two corridors that differ in their objects."""
    path = tmp_path_factory.mktemp("filtered") / "two.map"
    return make_map(path, make_model("rings"), a=building_update(seed=0), b=building_update(seed=1))


def known(localiser: Localiser) -> list[float]:
    assert localiser._filter is not None
    return [kept.walked for kept in localiser._filter._kept]


def test_full_updates_gaps_and_questions_leave_the_past_as_it_is(world):
    localiser = Localiser(world, BAYES)
    for i in range(14):
        localiser.update(delta(i, query=f"p{i + 5}") if i else building_update(query="p5"))
    before = known(localiser)
    assert len(before) > 1
    assert localiser.update(delta(50, query="p17")).matches.status == "no_graph"
    localiser.locate("p3")
    localiser.ask("p7")
    assert known(localiser) == before
    localiser.update(building_update(query="p18", seq=60))
    assert len(known(localiser)) == len(before)


def test_a_graph_that_begins_anew_begins_with_no_past(world):
    """A mapper that was restarted has a frame of its own: half of the places and more are gone, or elsewhere."""
    localiser = Localiser(world, BAYES)
    localiser.update(building_update(query="p5"))
    assert known(localiser)
    localiser.update(building_update(query="p5", seq=1))
    assert known(localiser), "the same graph again"
    again = building_update(query="p5", seq=2)
    moved = [msgspec.structs.replace(p, position=(p.position[0] + 9.0, *p.position[1:])) for p in again.places]
    localiser.apply(msgspec.structs.replace(again, places=moved))
    assert not known(localiser)


def test_another_localiser_goes_on_with_the_past_in_the_same_map_only(world, tmp_path):
    first = Localiser(world, BAYES)
    first.update(building_update(query="p5"))
    second, plain = Localiser(world, LocaliserConfig(filter="bayes", top_n=3)), Localiser(world)
    elsewhere = Localiser(make_map(tmp_path / "c.map", make_model("rings"), a=building_update(seed=7)), BAYES)
    for other in (plain, elsewhere, second):
        other.take_over(first)
    assert known(second) == known(first) != []
    assert known(elsewhere) == []
    assert plain._filter is None


def test_the_answer_is_calibrated_ranked_and_explained_as_without(world):
    result = Localiser(world, LocaliserConfig(filter="bayes")).update(building_update(query="p12"))
    assert result.attributions is not None
    assert result.attributions.match_place == result.matches.matches[0].place
    plain = Localiser(world).update(building_update(query="p12")).matches
    assert wire.encode(result.matches) == wire.encode(plain), "one answer has no past"


def test_an_empty_answer_stays_unknown(world):
    for update in (building_update(query=None), building_update(objects=0)):
        assert Localiser(world, BAYES).update(update).matches.status == "unknown"


def test_what_can_not_be_tested_can_not_be_filtered(world):
    with pytest.raises(ConfigError, match="expected rerank layout with filter bayes"):
        Localiser(world, LocaliserConfig(filter="bayes", rerank="none"))
    bare = LoadedMap(
        "bare", "", world.model, world.buildings, world.place_ids, world.positions, world.building_index,
        world.embeddings,
    )  # fmt: skip
    with pytest.raises(MapError, match="expected a map with scene graphs"):
        Localiser(bare, BAYES)


def test_an_update_that_is_refused_leaves_the_past_as_it_is(world):
    localiser = Localiser(world, BAYES)
    localiser.update(building_update(query="p5"))
    before = known(localiser)
    with pytest.raises(Exception, match="unknown"):
        localiser.update(msgspec.structs.replace(building_update(seq=1), edges=[("p0", "nowhere")]))
    assert known(localiser) == before
