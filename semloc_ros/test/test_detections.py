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
"""The bridge for detections, on real vision_msgs and tf2: what a robot sees comes out as a graph."""

import itertools
import math
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from conftest import wait_for
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.srv import DescribeParameters
from rclpy.parameter import Parameter
from semloc_ros.detections_bridge import DetectionsBridge
from std_msgs.msg import Empty, String
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesis, ObjectHypothesisWithPose

from semloc_core import wire
from semloc_core.graph import UpdateStream
from semloc_ros import qos

NAMES = itertools.count()
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
THINGS = {"chair": (3.0, 1.0, 0.4), "tv": (3.5, -1.0, 1.0)}


def stamp(message, seconds):
    message.sec, message.nanosec = int(seconds), round(seconds % 1 * 1e9)


class Robot:
    """Drives along x and sends what its drivers would."""

    def __init__(self, node):
        self.node, self.stream, self.updates = node, UpdateStream(), []
        self.detections = node.create_publisher(Detection3DArray, "detections", qos.SENSORS)
        self.rear = node.create_publisher(Detection3DArray, "rear", qos.SENSORS)
        self.odometry = node.create_publisher(Odometry, "odometry", qos.SENSORS)
        self.grid = node.create_publisher(OccupancyGrid, "grid", qos.LATCHED)
        self.tf = node.create_publisher(TFMessage, "/tf", qos.TRANSFORMS)
        self.static = node.create_publisher(TFMessage, "/tf_static", qos.LATCHED)
        self.request = node.create_publisher(Empty, "scene_graph/full_request", qos.LATEST)
        node.create_subscription(String, "scene_graph", self.take, qos.UPDATES)

    def take(self, message):
        update = wire.decode_update(message.data)
        self.stream.apply(update)
        self.updates.append(update)

    @property
    def objects(self):
        graph = self.stream.graph
        return {thing.class_: thing for thing in graph.objects.values()} if graph else {}

    def transform(self, parent, child, position, turn=(0.0, 0.0, 0.0, 1.0), seconds=0.0):
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = parent
        stamp(message.header.stamp, seconds)
        t, r = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z = position
        r.x, r.y, r.z, r.w = turn
        return message

    def mount(self):
        """Two cameras half a metre up, the rear one turned about, both optical."""
        x, y, z, w = OPTICAL
        turned = (-y, x, w, -z)
        front = self.transform("base_link", "front_optical_frame", (0.1, 0.0, 0.5), OPTICAL)
        rear = self.transform("base_link", "rear_optical_frame", (-0.1, 0.0, 0.5), turned)
        self.static.publish(TFMessage(transforms=[front, rear]))

    def move(self, x, seconds):
        self.tf.publish(TFMessage(transforms=[self.transform("odom", "base_link", (x, 0.0, 0.0), seconds=seconds)]))

    def odometer(self, x, seconds):
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id = "odom"
        stamp(message.header.stamp, seconds)
        message.pose.pose.position.x = x
        message.pose.pose.orientation.w = 1.0
        self.odometry.publish(message)

    def see(self, seconds, things, frame, publisher=None, track=""):
        """Things by class: their position in the frame."""
        message = Detection3DArray()
        message.header.frame_id = frame
        stamp(message.header.stamp, seconds)
        for class_, (x, y, z) in things.items():
            found = Detection3D(header=message.header, id=track)
            found.results.append(ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=class_, score=0.9)))
            centre = found.bbox.center.position
            centre.x, centre.y, centre.z = float(x), float(y), float(z)
            found.bbox.size.x = found.bbox.size.y = found.bbox.size.z = 0.5
            message.detections.append(found)
        (publisher or self.detections).publish(message)

    def ahead(self, x):
        """Where things are in the front camera's optical frame."""
        return {name: (-b, 0.5 - c, a - x - 0.1) for name, (a, b, c) in THINGS.items()}

    def connect(self, topics=("detections",)):
        for name in topics:
            wait_for(lambda name=name: self.node.count_subscribers(name), f"a subscriber of {name}")
        wait_for(lambda: self.node.count_publishers("scene_graph"), "the bridge to publish")
        wait_for(lambda: self.request.get_subscription_count(), "the bridge to listen")
        wait_for(lambda: self.detections.get_subscription_count() and self.tf.get_subscription_count(), "the bridge")
        return self


@pytest.fixture
def robot(spin):
    """Make a bridge with parameters, and a robot beside it."""

    def make(**parameters):
        space = f"/robot{next(NAMES)}"
        values = {"rate_hz": 100.0, "full_every_s": 1000.0} | parameters
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        spin(DetectionsBridge(namespace=space, parameter_overrides=overrides))
        return Robot(spin(rclpy.create_node("robot", namespace=space))).connect()

    return make


def test_what_cameras_see_is_where_tf2_says_and_waits_for_a_late_transform(robot):
    it = robot(topics=["detections", "rear"], wait_s=30.0, place_spacing_m=0.5)
    wait_for(it.rear.get_subscription_count, "the rear camera's subscription")
    it.mount()
    for step in range(8):
        seconds = 100.0 + 0.2 * step
        it.see(seconds, it.ahead(0.2 * step), "front_optical_frame")
        it.see(seconds, {"door": (-0.5, 0.0, 2.0 + 0.2 * step)}, "rear_optical_frame", it.rear)
    assert not it.updates  # no transform yet
    for step in range(8):
        it.move(0.2 * step, 100.0 + 0.2 * step)
    wait_for(lambda: {"chair", "tv", "door"} <= it.objects.keys(), "the objects")
    wait_for(lambda: it.updates[-1].stamp_ns == 101_400_000_000, "the last view")
    for name, position in THINGS.items():
        assert math.dist(it.objects[name].position, position) < 0.05
    assert math.dist(it.objects["door"].position, (-2.1, -0.5, 0.5)) < 0.05
    last = it.updates[-1]
    assert last.frame_id == last.odometry.frame_id == "odom"
    assert [round(p[0], 1) for p in sorted(it.stream.graph.places.values())] == [0.0, 0.6, 1.2]
    assert all(it.stream.graph.parents[key] for key in it.stream.graph.objects)

    it.request.publish(Empty())
    for step in range(8, 40):
        it.move(0.2 * step, 100.0 + 0.2 * step)
        it.see(100.0 + 0.2 * step, {}, "front_optical_frame")
        if wait_for(lambda: it.updates, "updates") and it.updates[-1].seq > 0 and it.updates[-1].full:
            break
    wait_for(lambda: it.updates[-1].stamp_ns > 101.4e9 and any(u.full for u in it.updates[1:]), "a full update")


def test_odometry_alone_is_enough_and_a_grid_gives_places(robot):
    it = robot(frame_id="odom")
    grid = OccupancyGrid()
    grid.header.frame_id = "odom"
    grid.info.resolution, grid.info.width, grid.info.height = 0.1, 60, 40
    grid.info.origin.position.x, grid.info.origin.position.y = -1.0, -2.0
    grid.info.origin.orientation.w = 1.0
    cells = np.zeros((40, 60), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:, 30] = 100  # a wall at x = 2 without a door
    grid.data = cells.ravel().tolist()
    it.grid.publish(grid)
    wait_for(it.grid.get_subscription_count, "the bridge to take grids")
    for step in range(200):
        it.odometer(0.0, 100.0 + 0.2 * step)
        it.see(100.0 + 0.2 * step, {"chair": (1.5, 0.5, 0.4)}, "base_link", track="7")
        if len(it.objects) == 1 and len(it.stream.graph.places) > 20:
            break
        wait_for(lambda step=step: it.updates and it.updates[-1].stamp_ns >= 100.0e9 + 0.2e9 * step, "its update")
    graph = it.stream.graph
    assert math.dist(it.objects["chair"].position, (1.5, 0.5, 0.4)) < 0.01
    sides = {place: position[0] < 2.0 for place, position in graph.places.items()}
    assert {True, False} == {*sides.values()}
    assert all(sides[a] == sides[b] for a, row in graph.neighbours.items() for b in row)
    assert it.updates[-1].query_place in graph.places


def test_parameters_are_described_and_ranged(spin):
    node = spin(DetectionsBridge(namespace=f"/robot{next(NAMES)}"))
    request = DescribeParameters.Request(names=["confirm_after", "association_m", "frame_id", "topics"])
    client = spin(rclpy.create_node("asking")).create_client(
        DescribeParameters, f"{node.get_fully_qualified_name()}/describe_parameters"
    )
    wait_for(client.service_is_ready, "the service")
    future = client.call_async(request)
    wait_for(future.done, "an answer")
    found = {one.name: one for one in future.result().descriptors}
    assert all(one.description for one in found.values())
    assert found["confirm_after"].integer_range[0].from_value == 1
    assert found["association_m"].floating_point_range[0].to_value == 100.0


def test_the_command_ends_in_order(environment):
    command = ["ros2", "run", "semloc_ros", "detections_bridge", "--ros-args", "-p", "confirm_after:=0"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert "confirm_after" in done.stderr
    assert "Traceback" not in done.stderr
    program = Path(get_package_prefix("semloc_ros")) / "lib" / "semloc_ros" / "detections_bridge"
    process = subprocess.Popen([str(program)], env=environment, stderr=subprocess.PIPE, text=True)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
