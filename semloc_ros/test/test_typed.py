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
"""Typed messages say what the JSON says; `processes/pipeline.py` compares both of a running node."""

import sys
from pathlib import Path

import building
import pytest
from conftest import wait_for

from semloc_core import wire
from semloc_ros import qos, typed

EXAMPLES = Path(__file__).resolve().parents[2] / "msgs_schema"
KINDS = {"place_matches": wire.PlaceMatches, "class_attributions": wire.ClassAttributions}
VALID = [path for name in KINDS for path in sorted((EXAMPLES / name / "valid").glob("*.json"))]


@pytest.mark.parametrize("path", VALID, ids=lambda path: f"{path.parts[-3]}-{path.stem}")
def test_json_to_typed_over_the_wire_and_back(path):
    from rclpy.serialization import deserialize_message, serialize_message

    pytest.importorskip("semloc_msgs")
    kind = KINDS[path.parts[-3]]
    there = wire.decode(path.read_bytes(), kind)
    message = typed.message_of(there)
    message = deserialize_message(serialize_message(message), type(message))
    assert wire.encode(typed.struct_of(message, kind)) == wire.encode(there)
    assert message.header.frame_id == there.frame_id
    assert there.schema == message.SCHEMA


def test_where_the_types_are_not_installed_json_is_published_alone(localiser, client, monkeypatch):
    monkeypatch.setitem(sys.modules, "semloc_msgs", None)
    typed.messages.cache_clear()
    try:
        localiser()
        side = client().connect()
        side.send(next(iter(building.steps(building.corridor()))).update)
        assert side.wait_matches(1)
        topics = dict(side.node.get_topic_names_and_types())
        assert not [topic for topic in topics if topic.endswith("_typed")]
    finally:
        typed.messages.cache_clear()


def test_typed_topics_are_silent_while_the_node_is_inactive_and_gone_when_it_is_cleaned_up(localiser, client):
    there = pytest.importorskip("semloc_msgs.msg")
    node, seen = localiser(), []
    side = client().connect()
    side.node.create_subscription(there.PlaceMatches, "/localiser/matches_typed", seen.append, qos.ANSWERS)
    wait_for(lambda: side.node.count_publishers("/localiser/matches_typed") == 1, "the typed topic")
    wait_for(lambda: node.count_subscribers("/localiser/matches_typed") == 1, "its subscriber")
    side.send(next(iter(building.steps(building.corridor()))).update)
    assert side.wait_matches(1)
    wait_for(lambda: seen, "a typed message")
    assert seen[0].status == there.PlaceMatches.STATUS_MATCH
    assert seen[0].matches[0].rank == 1
    node.trigger_deactivate()
    node.trigger_cleanup()
    wait_for(lambda: not side.node.count_publishers("/localiser/matches_typed"), "the topic to go")
