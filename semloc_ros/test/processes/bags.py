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
"""`ros2 bag play` drives the node to what `semloc replay` answers; what `ros2 bag record` writes can be scored."""

import json
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import scene
from conftest import wait_for
from rosbag2_interfaces.srv import PlayNext
from scene import Watching, describe, localiser

from semloc_core.config import LocaliserConfig
from semloc_core.map_database import load
from semloc_core.replay import ATTRIBUTIONS_TOPIC, MATCHES_TOPIC, replay, score_results
from semloc_core.sources import BagReader, decode_string, read_run
from semloc_core.wire import decode_update

STRING = "std_msgs/msg/String"


def generate_test_description():
    """Launch a localiser that reads the bag's clock."""
    return describe(localiser(use_sim_time=True, frame_id="map"))


def start(*command):
    """Start a command in a session of its own."""
    return subprocess.Popen(command, start_new_session=True)


def updates_of(run):
    """Updates of a run."""
    return [decode_update(item.text) for item in read_run(run)]


def by_seq(path, topic):
    """Texts of a topic, by their number, latency left out."""
    found = {}
    for message in BagReader(path, {topic: STRING}):
        values = json.loads(decode_string(message.data))
        if "latency_ms" in values:
            values["latency_ms"] = None
        found[values["seq"]] = json.dumps(values, separators=(",", ":"), ensure_ascii=False)
    return found


class TestBags(Watching):
    """One run there and back."""

    def test_play_is_replay_and_what_is_recorded_is_scored(self):
        run, map_file = scene.ASSETS / "run.mcap", scene.ASSETS / "home.map"
        node = self.client.node
        with tempfile.TemporaryDirectory() as folder:
            recorded, replayed = Path(folder) / "recorded", Path(folder) / "replayed.mcap"
            loaded = load(map_file)
            summary = replay(run, loaded, LocaliserConfig(frame_id="map"), results=replayed)
            core = {topic: by_seq(replayed, topic) for topic in (MATCHES_TOPIC, ATTRIBUTIONS_TOPIC)}
            assert list(core[MATCHES_TOPIC]) == [update.seq for update in updates_of(run)]
            assert len(core[ATTRIBUTIONS_TOPIC]) > 10

            topics = [MATCHES_TOPIC, ATTRIBUTIONS_TOPIC, "/ground_truth"]
            recorder = start("ros2", "bag", "record", "-s", "mcap", "-o", str(recorded), *topics)
            wait_for(lambda: node.count_subscribers(MATCHES_TOPIC) >= 2, "the recorder", 120)
            wait_for(lambda: node.count_subscribers(ATTRIBUTIONS_TOPIC) >= 2, "the recorder", 120)
            wait_for(lambda: node.count_subscribers("/scene_graph") == 1, "the localiser", 120)
            # Message by message: a rate that the node keeps up with, whatever else the machine does.
            player = start("ros2", "bag", "play", str(run), "--clock", "--start-paused")
            play_next = node.create_client(PlayNext, "/rosbag2_player/play_next")
            assert play_next.wait_for_service(120)
            wait_for(lambda: node.count_publishers("/scene_graph"), "the player's publishers", 120)
            wait_for(lambda: node.count_publishers("/ground_truth"), "the player's publishers", 120)
            time.sleep(2.0)  # until everyone knows everyone
            for update in updates_of(run):
                for _ in ("the update", "the true position"):
                    future = play_next.call_async(PlayNext.Request())
                    wait_for(future.done, "the player")
                    assert future.result().success
                self.wait_for_seq("matches", update.seq)
                if update.seq in core[ATTRIBUTIONS_TOPIC]:
                    self.wait_for_seq("attributions", update.seq)
            time.sleep(2.0)
            for process in (player, recorder):
                os.killpg(process.pid, signal.SIGINT)
                process.wait(60)

            for topic, texts in core.items():
                assert by_seq(recorded, topic) == texts, topic
            found, expected = (
                [{name: value for name, value in row.items() if name != "method"} for row in rows]
                for rows in (
                    score_results(
                        recorded, list(loaded.buildings), same_storey=loaded.same_storey, chance=loaded.chance
                    ),
                    summary.rows,
                )
            )
            assert found
            assert found == expected

    def wait_for_seq(self, topic, seq):
        seen = self.client.seen[f"{self.client.name}/{topic}"]
        wait_for(lambda: seen and json.loads(seen[-1].data)["seq"] == seq, f"{topic} {seq}")
