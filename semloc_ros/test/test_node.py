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
"""The node in process, on a real rclpy: transitions, parameters, every topic and service."""

import math
import re
import subprocess
import sys
import time
from pathlib import Path

import building
import pytest
import rclpy
from conftest import wait_for
from rclpy.lifecycle import TransitionCallbackReturn
from visualization_msgs.msg import Marker

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.map_database import load

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def state(node):
    return node._state_machine.current_state[1]


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


# -- lifecycle ------------------------------------------------------------------------------------------------------


def test_transitions_make_and_free_and_make_again(localiser, client):
    node = localiser(start=False)
    assert state(node) == "unconfigured"
    for _ in range(2):
        assert node.trigger_configure() == SUCCESS
        assert state(node) == "inactive"
        assert node.trigger_activate() == SUCCESS
        assert node.trigger_deactivate() == SUCCESS
        assert node.trigger_cleanup() == SUCCESS
        assert state(node) == "unconfigured"
        wait_for(lambda: node.count_publishers("/localiser/matches") == 0, "publishers to go")
        wait_for(lambda: node.count_subscribers("scene_graph") == 0, "subscriptions to go")
    node.trigger_configure()
    node.trigger_activate()
    side = client().connect()
    side.send(updates()[0])
    side.wait_matches(1)
    assert node.trigger_shutdown() == SUCCESS
    assert state(node) == "finalized"


def test_autostart_activates(localiser):
    assert state(localiser()) == "active"


@pytest.mark.parametrize("name", ["", "/nowhere/at/all.map", "broken.map"])
def test_a_bad_map_leaves_the_node_unconfigured_with_one_line(localiser, assets, capfd, name):
    node = localiser(map=str(assets / name) if name == "broken.map" else name)
    assert state(node) == "unconfigured"
    assert node.trigger_configure() == FAILURE
    lines = [line for line in capfd.readouterr().err.splitlines() if "configure failed" in line]
    assert len(lines) == 2
    assert "expected" in lines[0]
    assert "Traceback" not in lines[0]


def test_an_inactive_node_follows_the_graph_but_says_nothing(localiser, client):
    node = localiser(start=False)
    node.trigger_configure()
    side = client().connect()
    run = updates()
    for update in run[:3]:
        side.send(update)
    wait_for(lambda: node._session.worker.stream_counts()["applied"] == 3, "three updates")
    assert side.matches == []
    node.trigger_activate()
    side.send(run[3])
    answers = side.wait_matches(1)
    assert [a.seq for a in answers] == [3]
    assert answers[0].status in ("match", "ambiguous")


# -- parameters -----------------------------------------------------------------------------------------------------


def test_parameters_are_the_configurations_fields(localiser):
    from semloc_ros.parameters import NodeConfig

    node = localiser(start=False)
    for struct in (LocaliserConfig, NodeConfig):
        for name in struct.__struct_fields__:
            found = node.describe_parameter(name)
            assert found.description, name
    assert node.describe_parameter("top_n").integer_range[0].to_value == 100
    assert node.describe_parameter("accept_probability").floating_point_range[0].to_value == 1.0
    assert node.describe_parameter("autostart").read_only
    assert "attention" in node.describe_parameter("explainer").additional_constraints


@pytest.mark.parametrize(
    ("name", "value"),
    [("top_n", 0), ("top_n", 101), ("accept_probability", 1.5), ("explainer", "tea_leaves"), ("autostart", False),
     ("top_n", "many"), ("explain_rate_hz", -1.0), ("max_update_bytes", 3)],
)  # fmt: skip
def test_a_value_that_is_not_allowed_is_refused_and_changes_nothing(localiser, client, name, value):
    node = localiser()
    before = node.get_parameter(name).value
    (result,) = client().set(**{name: value})
    assert not result.successful
    assert result.reason
    assert node.get_parameter(name).value == before


def test_options_change_while_the_node_runs(localiser, client):
    localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    assert len(side.wait_matches(1)[0].matches) == 10
    assert side.set(top_n=3)[0].successful
    side.send(run[1])
    last = side.wait_matches(2)[-1]
    assert last.seq == 1
    assert len(last.matches) == 3


# -- answers --------------------------------------------------------------------------------------------------------


def test_answers_are_the_cores_byte_for_byte(localiser, client, assets):
    localiser(explain_rate_hz=1000.0, frame_id="home")
    side = client().connect()
    core = Localiser(load(assets / "home.map"), LocaliserConfig(explain_rate_hz=1000.0, frame_id="home"))
    for count, update in enumerate(updates()[:8], 1):
        side.send(update)
        answer = side.wait_matches(count)[-1]
        assert answer.latency_ms > 0
        wait_for(lambda count=count: len(side.attributions) == count, "attributions")
        expected = core.update(update)
        found = re.sub(r'"latency_ms":[0-9.e-]+', '"latency_ms":null', side.seen["/localiser/matches"][-1].data)
        assert found == wire.encode(expected.matches).decode()
        assert side.seen["/localiser/attributions"][-1].data == wire.encode(expected.attributions).decode()
        wait_for(lambda count=count: len(side.seen["/localiser/evidence"]) == count, "evidence")
        assert side.seen["/localiser/evidence"][-1].data == wire.encode(expected.evidence).decode()


def test_bad_updates_are_refused_counted_and_lose_nothing(localiser, client, capfd):
    localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)
    for text in ("", "{", "[]", '{"schema": "semloc/scene_graph_update/2"}', wire.encode(run[1]).decode()[:-20]):
        side.send(text)
    side.send(run[1])
    assert side.wait_matches(2)[-1].seq == 1
    found = wait_for(
        lambda: (d := side.diagnostics("localisation")) and any(v.value == "5" for v in d.values) and d, "diagnostics"
    )
    values = {v.key: v.value for v in found.values}
    assert values["updates rejected"] == "5"
    assert "expected" in values["last rejection"]
    lines = [line for line in capfd.readouterr().err.splitlines() if "update rejected" in line]
    assert 1 <= len(lines) <= 2


def test_text_that_is_not_utf8_does_not_end_the_node(localiser, client, spin):
    from std_msgs.msg import String

    from semloc_core.sources import encode_string
    from semloc_ros import qos

    localiser()
    side = client().connect()
    raw = spin(rclpy.create_node("raw")).create_publisher(String, "scene_graph", qos.UPDATES)
    wait_for(raw.get_subscription_count)
    raw.publish(encode_string(b"\xff\xfe not text"))
    wait_for(
        lambda: (
            (d := side.diagnostics("localisation")) and {v.key: v.value for v in d.values}["updates rejected"] == "1"
        ),
        "the refusal",
    )
    side.send(updates()[0])
    side.wait_matches(1)


def test_a_gap_is_no_graph_until_the_next_full_update(localiser, client):
    localiser()
    side = client().connect()
    run = updates(full_every_s=1.0)
    side.send(run[0])
    side.send(run[2])
    wait_for(lambda: side.matches and side.matches[-1].status == "no_graph", "no_graph")
    side.send(next(u for u in run[3:] if u.full))
    wait_for(lambda: side.matches[-1].status != "no_graph", "a graph again")


def test_every_delta_is_applied_and_only_the_latest_query_answered(localiser, client):
    node = localiser()
    side = client().connect()
    run = updates(distance_m=60.0)
    for update in run:
        side.send(update)
    answers = wait_for(lambda: (m := side.matches) and m[-1].seq == run[-1].seq and m, "the last answer")
    counts = node._session.worker.counts
    assert node._session.worker.stream_counts() == {"applied": len(run)}
    assert counts.answered + counts.skipped == len(run)
    assert [a.seq for a in answers] == sorted(a.seq for a in answers)


def test_the_pose_is_the_messages_and_comes_with_matches_only(localiser, client):
    localiser(frame_id="home")
    side = client().connect()
    run = updates(shared_frame=True, frame_id="odom")
    side.send(run[0])
    (found,) = wait_for(lambda: side.seen["/localiser/pose"])
    pose = side.wait_matches(1)[0].matches[0].pose
    assert pose.yaw is not None
    at, turn = found.pose.pose.position, found.pose.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx(pose.position, abs=1e-6)
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(pose.yaw, abs=1e-6)
    assert found.header.frame_id == "home"
    stamp = found.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == run[0].stamp_ns
    covariance, axes = found.pose.covariance.reshape(6, 6), [0, 1, 2, 5]
    assert covariance[axes][:, axes].ravel() == pytest.approx(pose.covariance, abs=1e-6)
    assert side.set(accept_probability=1.0)[0].successful
    side.send(run[1])
    assert side.wait_matches(2)[-1].status == "ambiguous"
    time.sleep(0.3)
    assert len(side.seen["/localiser/pose"]) == 1


def test_how_sure_the_pose_is_does_not_hang_on_how_many_matches_are_listed(localiser, client):
    localiser()
    side = client().connect()
    (update, *_) = updates()
    found = []
    for top_n in (1, 10, 100):
        assert side.set(top_n=top_n)[0].successful
        assert side.call("reset").success
        side.send(update)
        wait_for(lambda: len(side.seen["/localiser/pose"]) > len(found), "a pose")
        found.append(side.seen["/localiser/pose"][-1].pose.covariance.tolist())
    assert found[0] == found[1] == found[2]


def test_a_pose_without_a_heading_says_so(localiser, client):
    localiser()
    side = client().connect()
    side.send(updates()[0])  # its odometry is in a frame of its own
    (found,) = wait_for(lambda: side.seen["/localiser/pose"])
    turn, covariance = found.pose.pose.orientation, found.pose.covariance.reshape(6, 6)
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
    assert covariance[5, 5] == pytest.approx(math.pi**2 / 3)
    assert not covariance[5, :5].any()


def follow(side, run, before):
    """Send updates one by one, each when the one before has been answered."""
    for count, update in enumerate(run, before + 1):
        side.send(update)
        side.wait_matches(count)


def test_initialpose_is_told_after_consistent_matches_and_never_by_default(localiser, client, assets):
    localiser(accept_probability=0.0)
    side = client().connect()
    run = updates(speed_mps=0.1, shared_frame=True, frame_id="odom")
    follow(side, run[:4], 0)
    assert side.seen["initialpose"] == []
    assert side.set(initialpose_after=3)[0].successful
    follow(side, run[4:12], 4)
    wait_for(lambda: side.seen["initialpose"])
    time.sleep(0.3)
    (told,) = side.seen["initialpose"]
    assert told in side.seen["/localiser/pose"]
    assert told.pose.covariance.reshape(6, 6)[5, 5] < 1.0
    assert side.set(map=str(assets / "both.map"))[0].successful  # which has frames of its own
    follow(side, run[12:16], 12)
    wait_for(lambda: len(side.seen["initialpose"]) == 2)
    assert side.seen["initialpose"][-1].header.frame_id == "home"


def test_initialpose_is_never_told_without_a_heading(localiser, client):
    localiser(accept_probability=0.0, initialpose_after=1)
    side = client().connect()
    follow(side, updates()[:4], 0)
    time.sleep(0.3)
    assert len(side.seen["/localiser/pose"]) == 4
    assert side.seen["initialpose"] == []


def test_initialpose_is_told_again_to_who_comes_late_until_amcl_answers(localiser, client, spin):
    from geometry_msgs.msg import PoseWithCovarianceStamped

    from semloc_ros import qos

    localiser(accept_probability=0.0, initialpose_after=2)
    side = client().connect()
    follow(side, updates(speed_mps=0.1, shared_frame=True, frame_id="odom")[:3], 0)
    wait_for(lambda: len(side.seen["initialpose"]) == 1)

    def late(name):
        seen, node = [], spin(rclpy.create_node(name))
        node.create_subscription(PoseWithCovarianceStamped, "initialpose", seen.append, qos.LATEST)
        return seen, node

    amcl, node = late("amcl")
    wait_for(lambda: amcl, "the pose, though no update comes any more")
    answer = node.create_publisher(PoseWithCovarianceStamped, "amcl_pose", qos.LATCHED)
    count = len(amcl)
    wait_for(lambda: len(amcl) > count, "the pose again: AMCL is there and has not answered")
    answer.publish(PoseWithCovarianceStamped())
    time.sleep(0.5)
    count = len(amcl)
    other, _ = late("other")
    time.sleep(3.0)
    assert (len(amcl), other) == (count, [])


def test_a_persons_initialpose_narrows_the_search(localiser, client, spin, assets, capfd):
    from geometry_msgs.msg import PoseWithCovarianceStamped

    from semloc_ros import qos

    localiser(map=str(assets / "twins.map"), accept_probability=0.75)
    side = client().connect()
    rviz = spin(rclpy.create_node("rviz")).create_publisher(PoseWithCovarianceStamped, "initialpose", qos.LATEST)
    wait_for(lambda: rviz.get_subscription_count() >= 2, "the localiser and the test to listen")
    (update, *_) = updates()
    side.send(update)
    assert side.wait_matches(1)[-1].status == "ambiguous"
    hint = PoseWithCovarianceStamped()
    hint.header.frame_id = "map"  # which is no building's, where there are two
    rviz.publish(hint)
    wait_for(lambda: "not taken as a hint: expected" in capfd.readouterr().err, "a line")
    hint.header.frame_id = "there"
    rviz.publish(hint)
    time.sleep(0.5)
    side.send(update)
    answer = side.wait_matches(2)[-1]
    assert (answer.status, answer.frame_id, answer.matches[0].map) == ("match", "there", "there")


def test_of_a_map_of_several_buildings_everything_is_in_the_frame_of_its_building(localiser, client, assets):
    localiser(map=str(assets / "both.map"), explain_rate_hz=1000.0)
    side = client().connect()
    wait_for(lambda: side.node.count_publishers("/localiser/markers"))
    time.sleep(0.5)
    starts = {0: 1_700_000_000 * 10**9, 7: 1_700_000_100 * 10**9}
    runs = [
        [s.update for s in building.steps(building.corridor(seed=i), start_stamp_ns=t)][:1] for i, t in starts.items()
    ]
    for count, (name, run) in enumerate(zip(("home", "other"), runs, strict=True), 1):
        side.send(run[0])
        answer = side.wait_matches(count)[-1]
        assert (answer.status, answer.matches[0].map, answer.frame_id) == ("match", name, name)
        for topic in ("pose", "attributions", "evidence"):
            wait_for(lambda count=count, topic=topic: len(side.seen[f"/localiser/{topic}"]) == count, topic)
        assert side.seen["/localiser/pose"][-1].header.frame_id == name
        assert side.attributions[-1].frame_id == name
        assert side.messages("evidence", wire.ClassAttributions)[-1].frame_id == name
        drawn = wait_for(
            lambda name=name: (
                (found := [m for a in list(side.seen["/localiser/markers"]) for m in a.markers])
                and any(m.ns == "seen" and m.header.frame_id == name for m in found)
                and found
            )
        )
    frames = {(m.ns, m.header.frame_id) for m in drawn}
    assert ("robot", "home") in frames
    assert ("robot", "other") in frames
    assert not any(frame == "map" for ns, frame in frames if ns in ("robot", "matches", "seen", "explained"))
    (shown,) = wait_for(lambda: side.seen["/localiser/map_markers"])
    of = {m.ns: m.header.frame_id for m in shown.markers}
    assert (of["places of home"], of["places of other"]) == ("home", "other")


def test_markers_have_stable_ids_and_are_cleared_with_the_map(localiser, client, assets):
    localiser(explain_rate_hz=1000.0)
    side = client().connect()
    wait_for(lambda: side.node.count_publishers("/localiser/markers"))
    time.sleep(0.5)
    run = updates()
    for count, update in enumerate(run[:5], 1):
        side.send(update)
        side.wait_matches(count)
        wait_for(lambda count=count: len(side.attributions) == count, "attributions")
    wait_for(lambda: any(m.ns == "attributions" for a in side.seen["/localiser/markers"] for m in a.markers))
    drawn = [m for a in list(side.seen["/localiser/markers"]) for m in a.markers]
    assert {"matches", "probabilities", "query", "attributions", "robot", "seen"} <= {m.ns for m in drawn}
    joined = [m for m in drawn if m.ns == "explained" and m.points][-1]
    for here, there in zip(joined.points[::2], joined.points[1::2], strict=True):  # nothing has moved since
        assert math.dist((here.x, here.y, here.z), (there.x, there.y, there.z)) < 0.1
    assert {m.header.frame_id for m in drawn if m.ns in ("robot", "seen", "explained")} == {"map"}
    assert {m.id for m in drawn if m.ns == "matches"} == set(range(1, 11))
    assert {m.id for m in drawn if m.ns == "query"} == {0}
    first = wait_for(lambda: side.seen["/localiser/map_markers"])[0]
    assert first.markers[0].action == Marker.DELETEALL
    assert any(m.type == Marker.SPHERE_LIST and len(m.points) == 40 for m in first.markers)
    count = len(side.seen["/localiser/map_markers"])
    assert side.set(map=str(assets / "both.map"))[0].successful
    wait_for(lambda: len(side.seen["/localiser/map_markers"]) > count)
    wait_for(lambda: any(a.markers[0].action == Marker.DELETEALL for a in side.seen["/localiser/markers"]))


def test_the_publisher_in_the_docs_is_answered(localiser, client):
    page = (Path(__file__).resolve().parents[2] / "docs" / "ros.md").read_text()
    code = page.split("```python\n")[1].split("```")[0]
    localiser()
    side = client().connect()
    process = subprocess.Popen([sys.executable, "-c", code])
    try:
        assert side.wait_matches(2)[-1].status in ("match", "ambiguous")
    finally:
        process.kill()
        process.wait()


# -- maps -----------------------------------------------------------------------------------------------------------


def test_the_map_is_swapped_without_losing_the_graph(localiser, client, assets):
    localiser()
    side = client().connect()
    run = updates()
    for count, update in enumerate(run[:3], 1):
        side.send(update)
        before = side.wait_matches(count)[-1]
    assert side.set(map=str(assets / "attention.map"))[0].successful
    side.send(run[3])
    after = side.wait_matches(4)[-1]
    assert after.status != "no_graph"
    assert (before.map.name, after.map.name) == ("home", "attention")
    core = Localiser(load(assets / "attention.map"))
    for update in run[:4]:
        expected = core.update(update)
    assert after.matches == wire.decode(wire.encode(expected.matches), wire.PlaceMatches).matches


@pytest.mark.parametrize("name", ["nowhere.map", "broken.map", ""])
def test_a_bad_map_leaves_the_old_one_serving(localiser, client, assets, name):
    node = localiser()
    side = client().connect()
    (result,) = side.set(map=str(assets / name) if name else "")
    assert not result.successful
    assert "expected" in result.reason
    assert node.get_parameter("map").value == str(assets / "home.map")
    side.send(updates()[0])
    assert side.wait_matches(1)[0].map.name == "home"


def test_reload_takes_what_is_on_disk_now(localiser, client, assets, tmp_path):
    path = tmp_path / "growing.map"
    path.write_bytes((assets / "home.map").read_bytes())
    localiser(map=str(path))
    side = client().connect()
    side.send(updates()[0])
    assert side.wait_matches(1)[0].map.places == 40
    building.write_map(tmp_path / "new.map", building.make_model("rings"), other=building.corridor(30))
    (tmp_path / "new.map").replace(path)
    answer = side.call("reload_map")
    assert answer.success, answer.message
    side.send(updates()[1])
    assert side.wait_matches(2)[-1].map.places == 30
    path.write_bytes(b"not a map")
    answer = side.call("reload_map")
    assert not answer.success
    assert "expected" in answer.message
    side.send(updates()[2])
    assert side.wait_matches(3)[-1].map.places == 30


def test_reset_forgets_the_graph(localiser, client):
    localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)
    assert side.call("reset").success
    side.send(run[1])
    assert side.wait_matches(2)[-1].status == "no_graph"
    side.send(run[0])
    assert side.wait_matches(3)[-1].status != "no_graph"
