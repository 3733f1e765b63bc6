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
"""What the process tests share: who is launched, and a client that watches."""

import os
import threading
import unittest
from pathlib import Path

import rclpy
from conftest import Client, wait_for
from launch import LaunchDescription
from launch_ros.actions import LifecycleNode, Node
from launch_testing.actions import ReadyToTest
from rclpy.executors import SingleThreadedExecutor

ASSETS = Path(os.environ.get("SEMLOC_TEST_ASSETS", "."))


def localiser(map_name="home.map", namespace="", respawn=False, remappings=(), **parameters):
    """Describe a localiser."""
    return LifecycleNode(
        package="semloc_ros",
        executable="localiser",
        name="localiser",
        namespace=namespace,
        parameters=[{"map": str(ASSETS / map_name), "stale_after_s": 60.0, **parameters}],
        remappings=list(remappings),
        respawn=respawn,
        respawn_delay=0.5,
        output="screen",
    )


def player(namespace="", remappings=(), **parameters):
    """Describe a player of the test building, which loops."""
    values = {"graph": str(ASSETS / "home.json"), "loop": True, "rate_hz": 5.0, "full_every_s": 2.0, "distance_m": 30.0}
    return Node(
        package="semloc_ros",
        executable="scene_graph_player",
        name="player",
        namespace=namespace,
        parameters=[values | parameters],
        remappings=list(remappings),
        output="screen",
    )


def describe(*actions):
    """Launch these; the tests begin at once, and wait for what they need."""
    return LaunchDescription([*actions, ReadyToTest()])


class Watching(unittest.TestCase):
    """A test that watches the localisers named in ``names``."""

    names = ("/localiser",)

    @classmethod
    def setUpClass(cls):
        rclpy.init()
        cls.nodes = [
            rclpy.create_node("watching", namespace=name.removesuffix("localiser").rstrip("/") or None)
            for name in cls.names
        ]
        cls.clients = [Client(node, name) for node, name in zip(cls.nodes, cls.names, strict=True)]
        cls.client = cls.clients[0]
        cls.executor = SingleThreadedExecutor()
        for node in cls.nodes:
            cls.executor.add_node(node)
        cls.ended = threading.Event()
        cls.spinning = threading.Thread(target=cls.spin, daemon=True)
        cls.spinning.start()

    @classmethod
    def spin(cls):
        """Spin until it ends; the executor's own shutdown would free what its `spin` still uses."""
        while not cls.ended.is_set():
            cls.executor.spin_once(timeout_sec=0.1)

    @classmethod
    def tearDownClass(cls):
        cls.ended.set()
        cls.spinning.join()
        cls.executor.shutdown()
        for node in cls.nodes:
            node.destroy_node()
        rclpy.try_shutdown()

    def answers_after(self, count, client=None):
        """Wait for so many more matches."""
        client = client or self.client
        seen = client.seen[f"{client.name}/matches"]
        before = len(seen)
        wait_for(lambda: len(seen) >= before + count, f"{count} more matches", 120)
        return client.matches[before:]


def exit_codes(proc_info, executable):
    """Codes that the processes of an executable ended with."""
    return [info.returncode for info in proc_info if executable in info.action.process_details["cmd"][0]]
