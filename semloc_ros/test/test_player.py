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
"""What the player publishes: updates, and true poses in the building's frame, whatever the updates' frame does."""

import math

import pytest
import rclpy
from conftest import wait_for
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from semloc_ros.player import Player
from std_msgs.msg import String

from semloc_core.sources import StampedPose, read_run
from semloc_core.wire import decode_update, yaw_of
from semloc_ros import conversions, qos


@pytest.fixture
def played(spin):
    """Play with parameters until so many updates came: these, and the true poses by their stamp."""

    def play(count, **values):
        side = spin(rclpy.create_node("listener"))
        updates, truths = [], []
        side.create_subscription(String, "scene_graph", updates.append, qos.UPDATES)
        side.create_subscription(PoseStamped, "ground_truth", truths.append, qos.ANSWERS)
        values = {"rate_hz": 50.0} | values
        player = Player(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
        wait_for(lambda: player.count_subscribers("ground_truth") == 1, "the truth's subscriber")
        spin(player)
        wait_for(lambda: len(updates) >= count and len(truths) >= count, "the run")
        decoded = [decode_update(message.data) for message in list(updates)]
        return decoded, {conversions.stamp_ns(pose.header.stamp): pose for pose in list(truths)}

    return play


def xyz(point):
    return point.x, point.y, point.z


def turn(pose):
    q = pose.pose.orientation
    return yaw_of((q.x, q.y, q.z, q.w))


def test_the_truth_of_a_drifting_run_is_a_pose_in_the_buildings_frame(played, assets):
    updates, truths = played(
        60, graph=str(assets / "home.json"), frame_id="odom", shared_frame=True, drift=5.0, place_noise_m=0.0
    )
    assert {update.frame_id for update in updates} == {"odom"}
    assert {pose.header.frame_id for pose in truths.values()} == {"map"}
    both = [(update, truths[update.stamp_ns]) for update in updates if update.stamp_ns in truths]
    for _, pose in both:  # the corridor runs along x, a place a metre
        assert pose.pose.position.y == pytest.approx(0.0, abs=1e-6)
        assert math.sin(turn(pose)) == pytest.approx(0.0, abs=1e-6)
    update, pose = both[-1]  # where the robot believes to be has drifted off by then
    assert math.dist(update.odometry.position, xyz(pose.pose.position)) > 0.05


def test_a_run_is_played_with_its_truth_stamped_from_now_on(played, assets):
    recorded = list(read_run(assets / "run.mcap"))
    updates, truths = played(len(recorded), graph=str(assets / "run.mcap"))
    there = [decode_update(item.text) for item in recorded]
    assert [update.seq for update in updates] == [update.seq for update in there]
    assert [update.places for update in updates] == [update.places for update in there]
    shift = updates[0].stamp_ns - there[0].stamp_ns
    assert shift > 0
    assert {update.stamp_ns - shift for update in updates} == {update.stamp_ns for update in there}
    for update, item in zip(updates, recorded, strict=True):
        assert isinstance(item.truth, StampedPose)
        pose = truths[update.stamp_ns]
        assert xyz(pose.pose.position) == item.truth.position
        assert turn(pose) == pytest.approx(yaw_of(item.truth.orientation_xyzw))


def test_without_a_graph_it_says_so():
    from semloc_core.errors import FileFormatError

    with pytest.raises(FileFormatError, match="'graph' to name a Hydra file or a run"):
        Player()
