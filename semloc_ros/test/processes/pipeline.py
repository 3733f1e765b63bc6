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
"""Player, localiser, subscriber: answers come, the latched topic too; a killed node comes back, Ctrl-C is clean."""

import os
import signal
import subprocess
import time
from pathlib import Path

import rclpy
import scene
from conftest import wait_for
from scene import Watching, describe, localiser, player
from semloc_ros.typed import struct_of

from semloc_core import wire
from semloc_ros import qos


def generate_test_description():
    """Launch a player and a localiser that is started again when it is killed."""
    return describe(player(), localiser(respawn=True))


def pids_of(program="lib/semloc_ros/localiser"):
    found = subprocess.run(["pgrep", "-f", program], capture_output=True, text=True, check=False)
    return [int(pid) for pid in found.stdout.split() if os.environ["ROS_DOMAIN_ID"] == _domain(int(pid))]


def _domain(pid):
    try:
        environment = Path(f"/proc/{pid}/environ").read_text()
    except OSError:
        return None
    return dict(item.split("=", 1) for item in environment.split("\0") if "=" in item).get("ROS_DOMAIN_ID")


class TestPipeline(Watching):
    """In the order of their names."""

    def test_1_answers_and_explanations_come(self):
        answers = self.answers_after(10)
        assert {a.map.name for a in answers} == {"home"}
        assert any(a.status == "match" for a in self.answers_after(10))
        assert all(a.latency_ms > 0 for a in answers)
        wait_for(lambda: len(self.client.attributions) > 3, "attributions")
        wait_for(lambda: self.client.seen["/localiser/pose"], "a pose")

    def test_2_typed_messages_say_what_the_json_says(self):
        try:
            import semloc_msgs.msg as there
        except ImportError:
            self.skipTest("semloc_msgs is not installed")
        for topic, kind in (
            ("matches", wire.PlaceMatches),
            ("evidence", wire.ClassAttributions),
            ("attributions", wire.ClassAttributions),
        ):
            seen, message = [], getattr(there, kind.__name__)
            self.client.node.create_subscription(message, f"/localiser/{topic}_typed", seen.append, qos.ANSWERS)
            wait_for(lambda seen=seen: len(seen) >= 3, f"typed {topic}")
            texts = [message.data.encode() for message in list(self.client.seen[f"/localiser/{topic}"])]
            for message in list(seen):
                assert wire.encode(struct_of(message, kind)) in texts
                assert message.header.stamp.sec > 0

    def test_3_a_late_subscriber_gets_the_map_markers(self):
        from visualization_msgs.msg import MarkerArray

        late, seen = rclpy.create_node("late"), []
        late.create_subscription(MarkerArray, "/localiser/map_markers", seen.append, qos.LATCHED)
        try:
            end = time.monotonic() + 60
            while not seen and time.monotonic() < end:
                rclpy.spin_once(late, executor=self.late_executor(late), timeout_sec=0.1)
            assert len(seen) == 1
        finally:
            late.destroy_node()

    def late_executor(self, node):
        if not hasattr(self, "_late"):
            self._late = rclpy.executors.SingleThreadedExecutor()
            self._late.add_node(node)
        return self._late

    def test_4_a_killed_localiser_comes_back(self):
        before = wait_for(pids_of, "the localiser's process")
        explaining = wait_for(lambda: pids_of("semloc_ros.explain_process"), "the process that explains")
        for pid in before:
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: not set(explaining) & set(pids_of("semloc_ros.explain_process")), "it to end by itself")
        wait_for(lambda: (now := pids_of()) and not set(now) & set(before), "another process", 120)
        fresh = self.answers_after(30)
        assert fresh[-1].status in ("match", "ambiguous"), fresh[-1].status

    def test_5_sigint_ends_it_with_0(self):
        # One of its own, so that launch does not start it again.
        command = ["ros2", "run", "semloc_ros", "localiser", "--ros-args", "-r", "__node:=mortal"]
        command += ["-p", f"map:={scene.ASSETS / 'home.map'}"]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        wait_for(lambda: self.client.node.count_publishers("/mortal/matches"), "the other localiser", 120)
        wait_for(lambda: any(n == "mortal" for n in self.client.node.get_node_names()))
        time.sleep(2.0)  # in the middle of its work
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, (process.returncode, errors)
        assert "Traceback" not in errors, errors
