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
"""RViz's configuration and Foxglove's layout, against the publishers of a running node."""

import json
from pathlib import Path

import pytest
import rclpy
import yaml
from conftest import wait_for
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rosidl_runtime_py.utilities import get_message

RVIZ = Path(__file__).resolve().parents[1] / "rviz"
TYPES = {
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
POLICIES = {
    "Durability Policy": (DurabilityPolicy, "durability"),
    "History Policy": (HistoryPolicy, "history"),
    "Reliability Policy": (ReliabilityPolicy, "reliability"),
}
DRAWN_BY_FOXGLOVE = {*TYPES.values()}


@pytest.fixture
def published(localiser, spin):
    """What is known of the one publisher of a topic, as another node sees it."""
    localiser()
    watching = spin(rclpy.create_node("watching"))

    def info(topic):
        wait_for(lambda: watching.count_publishers(topic), f"a publisher of {topic}", 20)
        (found,) = watching.get_publishers_info_by_topic(topic)
        return found

    return info


def displays():
    document = yaml.safe_load((RVIZ / "localiser.rviz").read_text())
    return document["Visualization Manager"]


def test_rviz_shows_what_the_node_publishes(published):
    shown = {}
    for display in displays()["Displays"]:
        if "Topic" not in display:
            assert display["Class"] == "rviz_default_plugins/Grid"
            continue
        topic = display["Topic"]
        assert not topic["Value"].startswith("/"), "an absolute name would be wrong in a namespace"
        found = published(f"/{topic['Value']}")
        assert found.topic_type == TYPES[display["Class"]], topic["Value"]
        policies = {
            argument: kind.get_from_short_key(topic[name].lower().replace(" ", "_"))
            for name, (kind, argument) in POLICIES.items()
        }
        wanted = QoSProfile(depth=topic["Depth"], **policies)
        assert qos_check_compatible(found.qos_profile, wanted)[0] != QoSCompatibility.ERROR, topic["Value"]
        assert wanted.durability == found.qos_profile.durability, f"{topic['Value']}: latched on one side only"
        shown[topic["Value"]] = display
    assert set(shown) == {"localiser/map_markers", "localiser/markers", "localiser/pose"}


def test_rviz_opens_on_the_frame_that_is_published(localiser):
    node = localiser()
    assert displays()["Global Options"]["Fixed Frame"] == node.get_parameter("frame_id").value


def test_foxglove_shows_what_the_node_publishes(published):
    document = json.loads((RVIZ / "localiser.foxglove.json").read_text())
    panels = document["configById"]
    assert set(leaves(document["layout"])) == set(panels)
    three_d = panels["3D!localiser"]["topics"]
    assert {published(topic).topic_type for topic in three_d} <= DRAWN_BY_FOXGLOVE
    assert set(three_d) == {"/localiser/map_markers", "/localiser/markers", "/localiser/pose"}
    topic, field = panels["RawMessages!attributions"]["topicPath"].split(".")
    assert field in get_message(published(topic).topic_type).get_fields_and_field_types()
    diagnostics = published(panels["DiagnosticSummary!localiser"]["topicToRender"])
    assert diagnostics.topic_type == "diagnostic_msgs/msg/DiagnosticArray"


def leaves(layout):
    """Panels that a layout places."""
    if isinstance(layout, str):
        return [layout]
    return leaves(layout["first"]) + leaves(layout["second"])
