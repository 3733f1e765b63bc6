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
"""What a node should survive: messages that are no updates, clocks that stand still or jump, maps that vanish."""

import json
import time

import building
import pytest
import rclpy
from conftest import wait_for
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from semloc_core import wire
from semloc_core.graph import SceneGraph
from semloc_ros import conversions


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def values_of(side, line="localisation"):
    status = side.diagnostics(line)
    return {v.key: v.value for v in status.values} if status else {}


def text(update, **changed):
    """An update's text, some of its fields replaced by JSON as it stands."""
    fields = json.loads(wire.encode(update))
    marks = {name: f"@{name}@" for name in changed}
    written = json.dumps(fields | marks)
    for name, value in changed.items():
        written = written.replace(f'"@{name}@"', value)
    return written


BAD = {
    "no JSON": lambda u: "places: none",
    "NaN": lambda u: text(u, places='[{"id": "p", "position": [NaN, 0, 0]}]'),
    "an infinite number": lambda u: text(u, places='[{"id": "p", "position": [1e999, 0, 0]}]'),
    "nested a million deep": lambda u: "[" * 1_000_000,
    "nested deep in a field": lambda u: text(u, odometry='{"position":' * 100_000 + "1" + "}" * 100_000),
    "another version": lambda u: text(u, schema='"semloc/scene_graph_update/2"'),
    "half a surrogate pair": lambda u: text(u, frame_id=r'"\ud800"'),
    "a control character": lambda u: text(u, frame_id='"\x01"'),
    "a number of 100,000 digits": lambda u: text(u, seq="9" * 100_000),
    "20 MB": lambda u: text(u, frame_id='"' + "x" * 20_000_000 + '"'),
    "an edge to nowhere": lambda u: text(u, edges='[["p", "q"]]'),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_message_that_is_no_update_changes_nothing(localiser, client, kind):
    localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)
    side.send(BAD[kind](run[1]))
    side.send(run[1])
    assert side.wait_matches(2)[-1].seq == 1
    values = wait_for(lambda: (v := values_of(side)).get("updates rejected") == "1" and v, "the refusal to be counted")
    assert "expected" in values["last rejection"]
    assert len(values["last rejection"]) < 400
    assert values["last rejection"].isprintable()


@pytest.mark.parametrize("request_", ["", "{", '{"schema":"semloc/explain_request/1"}', "[" * 100_000])
def test_a_request_that_is_none_ends_nothing(localiser, client, request_):
    localiser()
    side = client().connect()
    side.request(request_)
    side.send(updates()[0])
    side.wait_matches(1)
    good = wire.ExplainRequest("semloc/explain_request/1", 0, "", 9, methods=["saliency"])
    side.request(good)
    wait_for(lambda: [e.seq for e in side.messages("explanations", wire.Explanation)] == [9], "an explanation")


def test_an_empty_graph_is_unknown_and_a_building_grows_from_it(localiser, client):
    localiser()
    side = client().connect()
    side.send(SceneGraph().to_update(0, 1_000_000_000, "map"))
    assert side.wait_matches(1)[0].status == "unknown"
    whole = building.corridor().to_update(1, 2_000_000_000, "map")
    fields = {name: getattr(whole, name) for name in whole.__struct_fields__}
    side.send(wire.SceneGraphUpdate(**fields | {"full": False}))
    assert side.wait_matches(2)[-1].status in ("match", "ambiguous")


def test_without_a_clock_simulated_time_holds_nothing_up(localiser, client):
    localiser(use_sim_time=True, stale_after_s=0.5)
    side = client().connect()
    wait_for(lambda: side.seen["/localiser/map_markers"], "the map")
    run = updates()
    for count, update in enumerate(run[:3], 1):
        side.send(update)
        assert side.wait_matches(count)[-1].stamp_ns == update.stamp_ns
    wait_for(lambda: (d := side.diagnostics("localisation")) and "stale input" in d.message, "stale, by another clock")
    wait_for(lambda: side.attributions, "attributions")


def test_a_clock_that_jumps_back_is_a_bag_that_loops(localiser, client):
    localiser(use_sim_time=True, explain_rate_hz=1.0)
    side = client().connect()
    clock = side.node.create_publisher(Clock, "/clock", 10)
    wait_for(clock.get_subscription_count, "the clock's subscriber")
    run = updates()
    for lap in (1, 2):
        for index, update in enumerate(run[:6]):
            clock.publish(Clock(clock=conversions.time_msg(update.stamp_ns)))
            side.send(update)
            count = 6 * (lap - 1) + index + 1
            assert side.wait_matches(count)[-1].seq == index
        wait_for(lambda lap=lap: len(side.attributions) == 2 * lap, f"attributions of lap {lap}")
    assert [a.seq for a in side.attributions] == [0, 5, 0, 5]
    assert values_of(side).get("updates repeated", "0") == "0"


def test_a_map_that_is_deleted_serves_on(localiser, client, assets, tmp_path):
    path = tmp_path / "vanishing.map"
    path.write_bytes((assets / "home.map").read_bytes())
    localiser(map=str(path))
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)
    path.unlink()
    assert not side.call("reload_map").success
    assert side.set(top_n=4)[0].successful
    for count, update in enumerate(run[1:30], 2):
        side.send(update)
        side.wait_matches(count)
    assert len(side.matches[-1].matches) == 4
    wait_for(lambda: "distance" in " ".join(values_of(side, "lost or changed?")), "the map's own class mix")
    assert side.call("explain").success


def test_a_map_without_places_is_served_and_said(localiser, client, tmp_path):
    building.write_map(tmp_path / "empty.map", building.make_model("rings"))
    localiser(map=str(tmp_path / "empty.map"))
    side = client().connect()
    side.send(updates()[0])
    assert side.wait_matches(1)[0].status == "no_graph"
    wait_for(lambda: (d := side.diagnostics(": map")) and "no places" in d.message, "diagnostics")


def test_a_second_node_of_the_same_name_does_not_end_the_first(localiser, client, assets):
    from semloc_ros.node import LocaliserNode

    localiser()
    side = client().connect()
    values = {"map": str(assets / "home.map"), "autostart": True}
    second = LocaliserNode(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
    second.start()
    wait_for(lambda: side.node.count_publishers("/localiser/matches") == 2, "both")
    second.free()
    second.destroy_node()
    wait_for(lambda: side.node.count_publishers("/localiser/matches") == 1, "the first to be alone again")
    side.send(updates()[0])
    side.wait_matches(1)
    time.sleep(0.2)
    assert len(side.matches) == 1
    assert rclpy.ok()


def test_a_bug_in_diagnostics_or_behind_a_question_costs_no_answer(localiser, client, monkeypatch, capfd):
    node = localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)

    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(node._session._diagnostics, "lines", broken)
    monkeypatch.setattr(node._session.worker, "call", broken)
    answer = side.call("explain")
    assert not answer.success
    assert "internal error" in answer.message
    said = ""
    for _ in range(60):
        said += capfd.readouterr().err
        if "diagnostics failed: ZeroDivisionError" in said:
            break
        time.sleep(0.1)
    else:
        raise AssertionError(said)
    side.send(run[1])
    assert side.wait_matches(2)[-1].seq == 1
