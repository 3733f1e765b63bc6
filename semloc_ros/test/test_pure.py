# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""What needs no node: conversions, poses, markers, the worker's queue, diagnostics' words, Hydra's binary form."""

import math
import threading
import time
from collections import Counter
from types import SimpleNamespace

import building
import numpy as np
import pytest
from conftest import wait_for
from geometry_msgs.msg import PoseWithCovarianceStamped
from semloc_ros.diagnostics import Diagnostics
from semloc_ros.explaining import ExplainCounts
from semloc_ros.pose import Consistency
from semloc_ros.worker import Worker
from visualization_msgs.msg import Marker

from semloc_core import wire
from semloc_core.config import LocaliserConfig, options
from semloc_core.errors import ConfigError, SemlocError
from semloc_core.graph import Outcome, UpdateStream
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
from semloc_ros import conversions, markers, parameters


def match(rank, position, probability, building_name="home"):
    return wire.Match(rank, building_name, f"p{rank}", position, 0.9, probability)


def answer(*matches, status="match", seq=0):
    return wire.PlaceMatches(
        schema="semloc/place_matches/1", stamp_ns=1_500_000_000, frame_id="map", seq=seq, query_place="q",
        status=status, matches=list(matches), raw_matches=None, rivals=[], map=None, model=None,
        calibrated=False, latency_ms=None,
    )  # fmt: skip


# -- conversions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stamp_ns", "sec", "nanosec"),
    [(0, 0, 0), (1_500_000_000, 1, 500_000_000), (-1, -1, 999_999_999), (2**62, 2**31 - 1, 999_999_999),
     (-(2**62), -(2**31), 0)],
)  # fmt: skip
def test_stamps_of_64_bits_become_ros_times_or_the_nearest(stamp_ns, sec, nanosec):
    found = conversions.time_msg(stamp_ns)
    assert (found.sec, found.nanosec) == (sec, nanosec)


def test_only_the_latency_differs_from_the_cores_bytes():
    plain = answer(match(1, (1.0, 2.0, 3.0), 0.8))
    published = wire.decode(conversions.matches_string(plain, 12.5).data, wire.PlaceMatches)
    assert published.latency_ms == 12.5
    fields = {name: getattr(published, name) for name in published.__struct_fields__}
    assert wire.PlaceMatches(**fields | {"latency_ms": None}) == plain


def pose(position=(1.0, 2.0, 3.0), yaw=0.5):
    return wire.Pose(position, yaw, [float(x) for x in range(16)])


def turned(orientation, vector):
    """A vector (3) turned by a quaternion message."""
    axis, w = np.array([orientation.x, orientation.y, orientation.z]), orientation.w
    return np.array(vector) + 2 * np.cross(axis, np.cross(axis, vector) + w * np.array(vector))


def test_a_pose_message_has_all_of_the_pose():
    message = conversions.pose_msg(pose(), None, 1_500_000_000, "home")
    assert isinstance(message, PoseWithCovarianceStamped)
    assert (message.header.frame_id, message.header.stamp.sec) == ("home", 1)
    assert (message.pose.pose.position.x, message.pose.pose.position.z) == (1.0, 3.0)
    assert turned(message.pose.pose.orientation, [1.0, 0.0, 0.0]) == pytest.approx([math.cos(0.5), math.sin(0.5), 0.0])
    covariance = np.reshape(message.pose.covariance, (6, 6))
    rows = [0, 1, 2, 5]
    assert np.array_equal(covariance[np.ix_(rows, rows)].ravel(), np.arange(16.0))
    assert not covariance[3:5].any()


def test_a_robot_that_leans_leans_in_its_pose_too():
    half = math.pi / 8  # nose 45 degrees down, in its own frame looking along x
    odometry = wire.Odometry((0.0, 0.0, 0.0), (0.0, math.sin(half), 0.0, math.cos(half)), "odom")
    message = conversions.pose_msg(pose(yaw=math.pi / 2), odometry, 0, "home")
    assert turned(message.pose.pose.orientation, [1.0, 0.0, 0.0]) == pytest.approx([0.0, 0.5**0.5, -(0.5**0.5)])


def test_an_unknown_heading_is_no_turn_whatever_odometry_says():
    odometry = wire.Odometry((0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), "elsewhere")
    turn = conversions.pose_msg(pose(yaw=None), odometry, 0, "home").pose.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)


def test_consistency_counts_matches_that_agree():
    near = [answer(match(1, (float(x), 0.0, 0.0), 1.0)) for x in range(4)]
    far, lost = answer(match(1, (50.0, 0.0, 0.0), 1.0)), answer(status="ambiguous")
    elsewhere = answer(match(1, (50.0, 0.0, 0.0), 1.0, "other"))
    consistency = Consistency(4.0)
    assert [consistency.add(a) for a in near] == [1, 2, 3, 4]
    assert [consistency.add(a) for a in (far, far, elsewhere, lost, elsewhere)] == [1, 2, 1, 0, 1]


# -- markers --------------------------------------------------------------------------------------------------------


def test_ids_stay_with_their_objects_and_are_not_given_twice():
    ids = markers.MarkerIds()
    first, gone = ids.update(["a", "b", "c"])
    assert gone == []
    second, gone = ids.update(["c", "d", "a"])
    assert (second["a"], second["c"]) == (first["a"], first["c"])
    assert gone == [first["b"]]
    assert len(set(second.values())) == 3
    for i in range(200):
        numbers, _ = ids.update([f"x{i}", f"x{i + 1}", "a"])
        assert len(set(numbers.values())) == 3
        assert numbers["a"] == first["a"]
        assert max(numbers.values()) < 10


def test_ranks_that_are_no_longer_there_are_deleted():
    drawn = markers.match_markers(answer(match(1, (0.0, 0.0, 0.0), 0.9)), 3, lambda building: "map").markers
    actions = {(m.ns, m.id): m.action for m in drawn}
    assert actions[("matches", 1)] == Marker.ADD
    assert actions[("matches", 2)] == actions[("probabilities", 3)] == Marker.DELETE
    assert next(m.text for m in drawn if m.ns == "probabilities" and m.id == 1) == "1: 0.90"


def test_what_speaks_for_a_match_and_against_it_differ_in_colour():
    around = markers.Surroundings("odom", (0.0, 0.0, 0.0), {"a": (1.0, 0.0, 0.0), "b": (2.0, 0.0, 0.0)})
    drawn = markers.attribution_markers({"a": 0.5, "b": -0.5, "unseen": 1.0}, around, markers.MarkerIds(), 0).markers
    colours = {m.pose.position.x: (m.color.r, m.color.g, m.color.b) for m in drawn}
    assert set(colours) == {1.0, 2.0}
    assert colours[1.0] != colours[2.0]
    assert {m.header.frame_id for m in drawn} == {"odom"}


def test_the_robot_is_an_arrow_on_its_ellipse():
    covariance = np.diag([0.04, 0.01, 0.5, 0.02]).ravel().tolist()
    message = conversions.pose_msg(wire.Pose((1.0, 2.0, 0.5), 0.5, covariance), None, 0, "home")
    arrow, ellipse = markers.robot_markers(message, yaw_known=True).markers
    assert (arrow.type, ellipse.type) == (Marker.ARROW, Marker.CYLINDER)
    assert turned(arrow.pose.orientation, [1.0, 0.0, 0.0]) == pytest.approx([math.cos(0.5), math.sin(0.5), 0.0])
    assert (ellipse.pose.position.x, ellipse.pose.position.z) == (1.0, 0.5)
    along = turned(ellipse.pose.orientation, [1.0, 0.0, 0.0])
    assert np.abs(along) == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)  # of the larger spread
    # 95 of 100 points of a normal distribution lie in it.
    points = np.random.default_rng(0).normal(size=(100_000, 2)) * [0.2, 0.1]
    inside = ((points / [ellipse.scale.x / 2, ellipse.scale.y / 2]) ** 2).sum(1) <= 1
    assert inside.mean() == pytest.approx(0.95, abs=0.005)
    assert markers.robot_markers(message, yaw_known=False).markers[0].type == Marker.SPHERE


def test_what_is_seen_is_laid_on_the_map_and_joined_to_what_explains_it():
    head = conversions.header(0, "home")
    objects = [
        markers.Laid((1.0, 2.0, 0.0), markers.WHITE, (1.5, 2.0, 0.0)),
        markers.Laid((3.0, 4.0, 0.0), markers.GREY, None),
    ]
    seen, joined = markers.laid_markers(head, objects).markers
    assert [(p.x, p.y) for p in seen.points] == [(1.0, 2.0), (3.0, 4.0)]
    assert seen.colors == [markers.WHITE, markers.GREY]
    assert [(p.x, p.y) for p in joined.points] == [(1.0, 2.0), (1.5, 2.0)]
    assert {m.action for m in markers.laid_markers(head, []).markers} == {Marker.DELETE}


def test_the_map_is_drawn_whole_with_buildings_apart(assets):
    loaded = load(assets / "both.map")
    drawn = markers.map_markers(loaded, str.upper, conversions.time_msg(0)).markers
    assert drawn[0].action == Marker.DELETEALL
    assert {m.ns for m in drawn[1:]} >= {"places of home", "places of other", "objects of home", "buildings"}
    assert sum(len(m.points) for m in drawn if m.ns.startswith("objects of")) == 120
    assert len({(m.ns, m.id) for m in drawn}) == len(drawn)


# -- parameters -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("struct", [LocaliserConfig, parameters.NodeConfig])
def test_descriptors_say_what_the_fields_say(struct):
    for option in options(struct):
        found = parameters.descriptor(option)
        assert found.description == option.description
        ranges = [*found.integer_range, *found.floating_point_range]
        assert bool(ranges) == (option.minimum is not None or option.maximum is not None)
        if ranges:
            assert ranges[0].from_value <= option.default <= ranges[0].to_value
        for choice in option.choices:
            assert choice in found.additional_constraints


# -- the worker -----------------------------------------------------------------------------------------------------


@pytest.fixture
def worker(assets):
    made = []

    def make(on_answer):
        rejected = []
        made.append(Worker(Localiser(load(assets / "home.map")), on_answer, rejected.append))
        made[-1].answering = True
        return made[-1], rejected

    yield make
    for each in made:
        each.stop()


def texts(**kwargs):
    return [wire.encode(step.update).decode() for step in building.steps(building.corridor(), **kwargs)]


def test_while_an_answer_takes_long_updates_are_applied_and_the_latest_is_answered(worker):
    gate, answered = threading.Event(), []

    def on_answer(given):
        answered.append(given.update.seq)
        gate.wait(30)

    work, _ = worker(on_answer)
    run = texts()
    work.put(run[0])
    wait_for(lambda: answered)
    for text in run[1:40]:
        work.put(text)
    gate.set()
    wait_for(lambda: answered[-1] == 39)
    assert answered == [0, 39]
    assert work.stream_counts() == Counter(applied=40)
    assert (work.counts.answered, work.counts.skipped) == (2, 38)


def test_a_stream_that_never_pauses_does_not_starve_answers(worker):
    answered, run, stop = [], texts(distance_m=5.0), threading.Event()
    work, _ = worker(lambda given: answered.append(given.update.seq))

    def flood():
        while not stop.is_set():
            for text in run:
                work.put(text)

    thread = threading.Thread(target=flood)
    thread.start()
    wait_for(lambda: len(answered) >= 20)
    stop.set()
    thread.join()


def test_an_error_in_publishing_costs_one_answer_not_the_thread(worker, caplog):
    answered = []

    def on_answer(given):
        answered.append(given.update.seq)
        if len(answered) == 1:
            raise RuntimeError("no publisher")

    work, _ = worker(on_answer)
    run = texts()
    work.put(run[0])
    wait_for(lambda: answered)
    work.put(run[0])
    wait_for(lambda: len(answered) == 2)
    assert "failed on an update" in caplog.text


def test_a_question_to_a_stopped_worker_is_an_error_not_a_wait(worker):
    gate = threading.Event()
    work, _ = worker(lambda given: gate.wait(30))
    work.put(texts()[0])
    time.sleep(0.1)
    waiting = []

    def ask():
        try:
            work.call(lambda localiser: None)
        except SemlocError as error:
            waiting.append(str(error))

    thread = threading.Thread(target=ask)
    thread.start()
    stopper = threading.Thread(target=work.stop)
    time.sleep(0.1)
    stopper.start()
    time.sleep(0.1)
    gate.set()
    stopper.join(30)
    thread.join(30)
    with pytest.raises(SemlocError):
        work.call(lambda localiser: None)
    assert not thread.is_alive()


def test_what_a_question_raises_goes_to_who_asked(worker):
    work, _ = worker(lambda given: None)
    with pytest.raises(ConfigError, match="mine"):
        work.call(lambda localiser: (_ for _ in ()).throw(ConfigError("mine")))
    assert work.call(lambda localiser: 7) == 7


# -- Hydra ----------------------------------------------------------------------------------------------------------


def test_hydras_binary_form_arrives_as_updates(assets):
    spark_dsg = pytest.importorskip("spark_dsg")
    from semloc_core.sources import DsgStream

    graph = spark_dsg.DynamicSceneGraph.load(str(assets / "home.json"))
    stream, receiver = DsgStream(None, 5.0), UpdateStream()
    assert stream.update(graph.to_binary(), False, 0, "map") is None  # a change of a graph that was never seen
    first = stream.update(graph.to_binary(), True, 0, "map")
    assert (first.full, len(first.places), len(first.objects)) == (True, 40, 60)
    assert receiver.apply(first)[0] is Outcome.APPLIED

    gone = sorted(building.corridor().objects)[0]
    graph.remove_node(int(gone))
    second = stream.update(graph.to_binary(), True, 1_000_000_000, "map")
    assert (second.full, second.removed_nodes, second.seq) == (False, [gone], 1)
    assert receiver.apply(second)[0] is Outcome.APPLIED
    assert gone not in receiver.graph.objects
    assert stream.update(graph.to_binary(), True, 6_000_000_000, "map").full  # one is due again
    assert not stream.update(graph.to_binary(), True, 6_100_000_000, "map").full
    stream.ask_full()
    assert stream.update(graph.to_binary(), True, 6_200_000_000, "map").full
    assert not stream.update(graph.to_binary(), True, 6_300_000_000, "map").full
    with pytest.raises(SemlocError, match="binary form"):
        stream.update(b"nonsense", True, 7_000_000_000, "map")
    assert stream.update(graph.to_binary(), False, 8_000_000_000, "map") is None  # what it changes is not known


def test_a_part_of_hydras_graph_leaves_the_rest_as_it_is(assets):
    spark_dsg = pytest.importorskip("spark_dsg")
    from semloc_core.sources import DsgStream

    home = building.corridor()
    graph = spark_dsg.DynamicSceneGraph.load(str(assets / "home.json"))
    stream, receiver = DsgStream(None, 5.0), UpdateStream()
    receiver.apply(stream.update(graph.to_binary(), True, 0, "map", number=1))

    places, objects = sorted(home.places), sorted(home.objects)
    moved, gone, edge = objects[0], objects[1], (places[3], places[4])
    for node in [*home.places, *objects[1:]]:
        graph.remove_node(int(node))
    graph.get_node(int(moved)).attributes.position = [1.0, 2.0, 3.0]
    change = stream.update(graph.to_binary(), False, 1, "map", [int(gone)], [int(node) for node in edge], number=2)
    receiver.apply(change)
    after = receiver.graph
    assert after.objects.keys() == home.objects.keys() - {gone}
    assert after.objects[moved].position == (1.0, 2.0, 3.0)
    assert after.parents[moved] == home.parents[moved]
    assert after.places == home.places
    assert (edge[1] in home.neighbours[edge[0]], edge[1] in after.neighbours[edge[0]]) == (True, False)

    with pytest.raises(SemlocError, match="expected change 3"):
        stream.update(graph.to_binary(), False, 2, "map", number=4)
    assert stream.update(graph.to_binary(), False, 3, "map", number=5) is None


def test_the_query_place_is_that_of_the_latest_pose():
    from semloc_core.sources import AgentPose, odometry, query_place

    graph, upright = building.corridor(), (0.0, 0.0, 0.0, 1.0)
    names = sorted(graph.places, key=lambda name: graph.places[name][0])

    def asked(*agents):
        return query_place(graph, {agent.id: agent for agent in agents})

    assert asked() is None
    near = AgentPose(5, (7.2, 0.3, 0.0), upright, "2")
    assert asked(near, AgentPose(1, (0.0, 0.0, 0.0), upright, "10")) == names[7]
    assert asked(near, AgentPose(9, (7.2, 0.3, 0.0), upright, "3", place=names[2])) == names[2]
    poses = {"2": near, "10": AgentPose(1, (0.0, 0.0, 0.0), upright, "10")}
    assert odometry(poses, "hydra_map") == wire.Odometry((7.2, 0.3, 0.0), upright, "hydra_map")
    assert odometry(poses | {"3": AgentPose(9, (1.0, 0.0, 0.0), None, "3")}, "hydra_map") is None
    assert odometry({}, "hydra_map") is None


def test_the_bridge_says_in_one_line_what_is_missing(capsys):
    from semloc_ros.hydra_bridge import main

    pytest.importorskip("rclpy")
    try:
        import hydra_msgs  # noqa: F401
    except ImportError:
        assert main() == 2
        assert capsys.readouterr().err.count("\n") == 1
    else:
        pytest.skip("hydra_msgs is installed here")


# -- diagnostics ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("found", "reason", "words"),
    [([], "no query place", "unknown: no query place"),
     ([match(1, (1.0, 2.0, 0.5), 0.04)], "", "unknown: probably in no building of the map; the best of it is home")],
)  # fmt: skip
def test_diagnostics_say_whether_unknown_is_nothing_to_go_by_or_another_building(assets, found, reason, words):
    worker = Worker(Localiser(load(assets / "home.map")), lambda answer: None, lambda line: None)
    worker.stop()
    worker.updated_ns = time.monotonic_ns()
    query = SimpleNamespace(reason=reason)
    told = Diagnostics()
    told.answered(SimpleNamespace(located=SimpleNamespace(matches=answer(*found, status="unknown"), query=query)), 1.0)
    line = told.lines(worker, ExplainCounts(), None, "active", 60.0)[0]
    assert line.level == "warn"
    assert line.message.startswith(words)
