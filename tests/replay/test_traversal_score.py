"""The closing table of a replay: a wrong bracket or building would flatter or slander the localiser."""

import msgspec
import numpy as np
import pytest
from small_building import building_update, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.replay.traversal_score import LatencyHistogram, TraversalScore
from semloc_core.wire import Match, PlaceMatches


def answer(*places: tuple[str, float], status: str = "match") -> PlaceMatches:
    matches = [
        Match(rank=i + 1, map=building, place=str(i), position=(x, 0.0, 0.0), similarity=1.0, probability=0.5)
        for i, (building, x) in enumerate(places)
    ]
    return PlaceMatches(
        schema="semloc/place_matches/1", stamp_ns=0, frame_id="map", seq=0, query_place="q", status=status,
        matches=matches, raw_matches=None, rivals=[], map=None, model=None, calibrated=False, latency_ms=None,
    )  # fmt: skip


def test_success_by_distance_travelled():
    score = TraversalScore(["home"])
    score.add(answer(("home", 0.0)), (0.0, 0.0, 0.0), "home")  # right at 0 m
    score.add(answer(("home", 0.0), ("home", 6.0)), (6.0, 0.0, 0.0), "home")  # second of two is right at 6 m
    score.add(answer(status="unknown"), (6.0, 6.0, 0.0), "home")  # no answer at 12 m
    rows = {row["scope"]: row for row in score.rows("m")}
    assert list(rows) == ["0m", "5m", "10m", "all"]
    assert rows["0m"]["success@1"] == 1
    assert (rows["5m"]["success@1"], rows["5m"]["success@5"]) == (0, 1)
    assert (rows["10m"]["success@10"], rows["10m"]["answered"]) == (0, 0)
    assert rows["all"]["queries"] == 3
    assert rows["all"]["precision"] == pytest.approx(0.5)


def test_chance_is_the_share_of_the_places_that_would_be_right():
    score = TraversalScore(["home"], chance=lambda building, position: position[0] / 10)
    for x in (0.0, 2.0, 7.0):
        score.add(answer(("home", x)), (x, 0.0, 0.0), "home")
    rows = {row["scope"]: row["chance"] for row in score.rows("m")}
    assert rows == pytest.approx({"0m": 0.1, "5m": 0.7, "all": 0.3})
    unknown = TraversalScore(["home"])
    unknown.add(answer(("home", 0.0)), (0.0, 0.0, 0.0), "home")
    assert unknown.rows("m")[0]["chance"] is None


def test_a_maps_chance_is_that_of_the_function_that_judges_answers(tmp_path):
    """Every place of a map as an answer of its own: the share that is right."""
    update = building_update(length=30)
    loaded = make_map(tmp_path / "a.map", make_model("rings"), home=update, office=building_update(length=10))
    score = TraversalScore(loaded.buildings, same_storey=loaded.same_storey, chance=loaded.chance)
    at = (3.0, 0.5, 0.0)
    for building, id_, xyz in zip(
        [loaded.buildings[i] for i in loaded.building_index], loaded.place_ids, loaded.positions.tolist(), strict=True
    ):
        match = Match(rank=1, map=building, place=id_, position=tuple(xyz), similarity=1.0, probability=0.5)
        score.add(msgspec.structs.replace(answer(), matches=[match]), at, "home")
    row = score.rows("m")[-1]
    assert row["chance"] == pytest.approx(row["success@1"])
    assert row["chance"] == pytest.approx(7 / 40)
    narrowed = Localiser(loaded.narrowed(["home"]), LocaliserConfig(buildings=("home",)))
    assert narrowed.chance("home", at) == pytest.approx(7 / 30)
    assert narrowed.chance("office", at) == 0.0


def test_exactly_four_metres_is_right_and_more_is_wrong():
    score = TraversalScore(["home"])
    score.add(answer(("home", 4.0)), (0.0, 0.0, 0.0), "home")
    score.add(answer(("home", 4.001)), (0.0, 0.0, 0.0), "home")
    assert score.rows("m")[-1]["success@1"] == 0.5


def test_how_far_off_is_told_of_right_answers_alone():
    score = TraversalScore(["home"])
    for x in (1.0, 2.0, 3.0, 30.0):
        score.add(answer(("home", x)), (0.0, 0.0, 0.0), "home")
    assert score.rows("m")[-1]["error_m"] == pytest.approx(2.0, rel=0.02)
    lost = TraversalScore(["home"])
    lost.add(answer(("home", 9.0)), (0.0, 0.0, 0.0), "home")
    assert lost.rows("m")[-1]["error_m"] is None


def test_the_right_spot_in_the_wrong_building_is_wrong():
    score = TraversalScore(["a", "b"])
    assert score.add(answer(("b", 0.0)), (0.0, 0.0, 0.0), "a")
    assert score.rows("m")[-1]["success@1"] == 0


def test_a_truth_of_no_known_building_is_not_scored_but_counted():
    score = TraversalScore(["a", "b"])
    assert not score.add(answer(("a", 0.0)), (0.0, 0.0, 0.0), "odom")
    assert score.rows("m") == []
    assert score.unscored == 1


def test_one_building_takes_a_truth_in_any_frame():
    score = TraversalScore(["a"])
    assert score.add(answer(("a", 0.0)), (0.0, 0.0, 0.0), "map")
    assert score.rows("m")[-1]["success@1"] == 1


def test_a_truth_in_a_building_that_was_left_out_makes_answers_wrong():
    score = TraversalScore(["hq_2"], ["hq_1"])
    assert score.add(answer(("hq_2", 0.0)), (0.0, 0.0, 0.0), "hq_1")
    assert score.rows("m")[-1]["success@10"] == 0
    assert score.unscored == 0
    assert score.add(answer(("hq_2", 0.0)), (0.0, 0.0, 0.0), "odom")
    assert score.rows("m")[-1]["success@1"] == 0.5


def test_latency_percentiles_agree_with_numpy_to_two_percent():
    values = np.random.default_rng(0).lognormal(0.0, 1.0, 5000)
    histogram = LatencyHistogram()
    for value in values:
        histogram.add(value)
    for percent in (50, 99):
        assert histogram.percentile(percent) == pytest.approx(np.percentile(values, percent), rel=0.02)
    assert LatencyHistogram().percentile(50) is None


def test_a_match_on_another_storey_is_wrong_however_near_and_counted():
    score = TraversalScore(["home"], same_storey=lambda building, place, position: place != "0")
    score.add(answer(("home", 0.0), ("home", 1.0)), (0.0, 0.0, 2.7), "home")
    (row,) = [row for row in score.rows("m") if row["scope"] == "all"]
    assert (row["success@1"], row["success@5"], row["precision"], row["wrong_storey"]) == (0, 1, 0, 1)
