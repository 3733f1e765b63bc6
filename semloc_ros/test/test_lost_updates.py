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
"""Updates that are lost are said, and a full one is asked for; without this, the graph is gone until one comes by."""

import building
import rclpy
from conftest import wait_for
from rclpy.parameter import Parameter
from std_msgs.msg import Empty, String

from semloc_core import wire
from semloc_ros import qos

REQUESTS = "/scene_graph/full_request"


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def test_a_full_update_is_asked_for_after_a_loss_and_only_then(localiser, client, capfd):
    localiser()
    side = client().connect()
    asked = []
    side.node.create_subscription(Empty, REQUESTS, asked.append, qos.LATEST)
    wait_for(lambda: side.node.count_publishers(REQUESTS) == 1, "who asks")
    run = updates(full_every_s=1000.0)
    for count, update in enumerate(run[:3], 1):
        side.send(update)
        side.wait_matches(count)
    side.send(run[10])
    assert side.wait_matches(4)[-1].status == "no_graph"
    wait_for(lambda: asked, "a request")
    assert "updates lost: 10 came after 2" in capfd.readouterr().err
    side.send("garbage")  # a full update would not help
    side.send(run[0])
    assert side.wait_matches(5)[-1].status == "match"
    assert len(asked) == 1


def test_the_player_answers_with_a_full_update_and_the_localiser_finds_itself_again(localiser, client, spin, assets):
    from semloc_ros.player import Player

    localiser(stale_after_s=60.0)
    side = client().connect()
    seen = []
    side.node.create_subscription(String, "scene_graph", seen.append, qos.UPDATES)
    values = {"graph": str(assets / "home.json"), "full_every_s": 1e6, "rate_hz": 5.0, "loop": True}
    spin(Player(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()]))
    wait_for(lambda: side.node.count_subscribers(REQUESTS) == 1, "who is asked")
    side.wait_matches(3)
    assert side.call("reset").success  # as if all had been lost
    wait_for(lambda: sum(wire.decode_update(m.data).full for m in list(seen)) >= 2, "another full update")
    answers = len(side.matches)
    wait_for(lambda: any(m.status != "no_graph" for m in side.matches[answers:]), "the graph to be there again")
    full = [u for u in (wire.decode_update(m.data) for m in seen) if u.full][1]
    assert full.places
    assert full.seq > 0


def test_who_remaps_the_updates_remaps_the_request(spin):
    node = spin(rclpy.create_node("remapped", cli_args=["--ros-args", "-r", "scene_graph:=/robot/dsg"]))
    assert qos.full_request_topic(node) == "/robot/dsg/full_request"
