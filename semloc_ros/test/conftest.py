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
"""Fixtures: assets, and nodes that spin in a thread of their own."""

import os
import subprocess
import threading
import time
from pathlib import Path

import building
import pytest
import rclpy
import torch
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter

PATIENCE_S = 60.0
SCENES = Path(__file__).parent / "processes"


def wait_for(condition, what="it", patience_s=PATIENCE_S):
    """Wait until a condition holds, and return what it returned."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"waited {patience_s} s for {what}")


@pytest.fixture(scope="session")
def assets(tmp_path_factory):
    torch.set_num_threads(1)
    return building.make_all(tmp_path_factory.mktemp("assets"))


@pytest.fixture(scope="session", autouse=True)
def _ros():
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def environment(assets, tmp_path):
    """What processes of a test are started with: a network of their own, so that no node of another test is heard."""
    found = subprocess.run(["ros2", "pkg", "executables", "semloc_ros"], capture_output=True, text=True, check=False)
    assert "semloc_ros localiser" in found.stdout, "expected the built workspace to be sourced"
    return os.environ | {
        "SEMLOC_TEST_ASSETS": str(assets),
        "PYTHONPATH": os.pathsep.join([str(SCENES), str(SCENES.parent), os.environ.get("PYTHONPATH", "")]),
        "ROS_DOMAIN_ID": str((int(os.environ.get("ROS_DOMAIN_ID", "0")) + 1) % 102),
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }


@pytest.fixture
def spin():
    """Spin nodes in the background; they are destroyed when the test is over."""
    executor = MultiThreadedExecutor(8)
    nodes = []

    def add(node):
        nodes.append(node)
        executor.add_node(node)
        return node

    stop = threading.Event()

    def turn():
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=turn, daemon=True)
    thread.start()
    yield add
    stop.set()
    thread.join(10)
    executor.shutdown()
    for node in nodes:
        if hasattr(node, "free"):
            node.free()
        node.destroy_node()


@pytest.fixture
def localiser(spin, assets):
    """Make a localiser node with parameters given; autostarted unless told otherwise."""
    from semloc_ros.node import LocaliserNode

    def make(start=True, **parameters):
        values = {"map": str(assets / "home.map"), "autostart": start} | parameters
        node = LocaliserNode(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])
        node.start()
        return spin(node)

    return make


class Client:
    """The other end of the localiser's topics."""

    def __init__(self, node, name="/localiser"):
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from std_msgs.msg import String
        from visualization_msgs.msg import MarkerArray

        from semloc_ros import qos

        self.node, self.name = node, name
        self.seen = {}
        self._publisher = node.create_publisher(String, "scene_graph", qos.UPDATES)
        self._requests = node.create_publisher(String, f"{name}/explain_request", qos.ANSWERS)
        for topic, kind, profile in (
            (f"{name}/matches", String, qos.ANSWERS),
            (f"{name}/attributions", String, qos.ANSWERS),
            (f"{name}/evidence", String, qos.ANSWERS),
            (f"{name}/explanations", String, qos.ANSWERS),
            (f"{name}/pose", PoseWithCovarianceStamped, qos.ANSWERS),
            ("initialpose", PoseWithCovarianceStamped, qos.LATEST),
            (f"{name}/markers", MarkerArray, qos.LATEST),
            (f"{name}/map_markers", MarkerArray, qos.LATCHED),
            ("/diagnostics", DiagnosticArray, qos.LATEST),
        ):
            self.seen[topic] = []
            node.create_subscription(kind, topic, self.seen[topic].append, profile)

    def connect(self):
        """Wait until publisher and subscriptions know the localiser."""
        wait_for(lambda: self._publisher.get_subscription_count(), "the localiser to subscribe")
        wait_for(lambda: self.node.count_publishers(f"{self.name}/matches"), "the localiser to publish")
        wait_for(lambda: self._requests.get_subscription_count(), "the localiser to take requests")
        time.sleep(0.2)
        return self

    def send(self, update):
        """Publish an update: a message, or text."""
        from std_msgs.msg import String

        from semloc_core import wire

        text = update if isinstance(update, str) else wire.encode(update).decode()
        self._publisher.publish(String(data=text))

    def request(self, request):
        """Publish an explain request."""
        from std_msgs.msg import String

        from semloc_core import wire

        text = request if isinstance(request, str) else wire.encode(request).decode()
        self._requests.publish(String(data=text))

    def messages(self, topic, kind):
        """What came on a topic of the localiser, decoded."""
        from semloc_core import wire

        return [wire.decode(m.data, kind) for m in list(self.seen[f"{self.name}/{topic}"])]

    @property
    def matches(self):
        from semloc_core import wire

        return self.messages("matches", wire.PlaceMatches)

    @property
    def attributions(self):
        from semloc_core import wire

        return self.messages("attributions", wire.ClassAttributions)

    def wait_matches(self, count):
        """Wait for so many matches, and return all that came."""
        seen = self.seen[f"{self.name}/matches"]
        wait_for(lambda: len(seen) >= count, f"{count} matches")
        return self.matches

    def call(self, service):
        """Call a Trigger service of the localiser."""
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, f"{self.name}/{service}")
        assert client.wait_for_service(PATIENCE_S), service
        future = client.call_async(Trigger.Request())
        wait_for(future.done, f"the answer of {service}", 150)
        return future.result()

    def set(self, **values):
        """Set parameters as `ros2 param set` does."""
        from rcl_interfaces.srv import SetParameters

        client = self.node.create_client(SetParameters, f"{self.name}/set_parameters")
        assert client.wait_for_service(PATIENCE_S)
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        future = client.call_async(SetParameters.Request(parameters=parameters))
        wait_for(future.done, "parameters to be set")
        return future.result().results

    def diagnostics(self, line):
        """The latest status of a line."""
        found = [s for m in list(self.seen["/diagnostics"]) for s in m.status if s.name.endswith(line)]
        return found[-1] if found else None


@pytest.fixture
def client(spin):
    def make(name="/localiser", namespace=None):
        return Client(spin(rclpy.create_node("test_client", namespace=namespace)), name)

    return make
