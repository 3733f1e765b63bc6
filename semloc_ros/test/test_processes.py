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
"""The node as processes, launched by launch_testing: one file of test/processes a scene."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from conftest import SCENES

from semloc_core import wire
from semloc_core.sources import BagReader, decode_string


@pytest.mark.parametrize("name", ["pipeline", "robots", "swap", "bags", "hydra"])
def test_scene(name, environment):
    if name == "hydra":
        pytest.importorskip("hydra_msgs")
        pytest.importorskip("spark_dsg")
    command = [sys.executable, "-m", "launch_testing.launch_test", str(SCENES / f"{name}.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=420, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-8000:]


def test_a_run_is_launched_and_its_answers_recorded(assets, environment, tmp_path):
    command = ["ros2", "launch", "semloc_ros", "replay.launch.py", f"bag:={assets / 'run.mcap'}", "rate:=4.0"]
    command += [f"map:={assets / 'home.map'}", "frame_id:=home", f"record:={tmp_path / 'answers'}"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-8000:]
    topics = {"/localiser/matches": "std_msgs/msg/String", "/clock": "rosgraph_msgs/msg/Clock"}
    recorded = list(BagReader(tmp_path / "answers", topics))
    assert {message.topic for message in recorded} == set(topics)
    answers = [decode_string(message.data) for message in recorded if message.topic == "/localiser/matches"]
    assert {wire.decode(text, wire.PlaceMatches).frame_id for text in answers} == {"home"}


@pytest.mark.parametrize(
    ("arguments", "line"),
    [(["-p", "top_n:=0"], "top_n"), (["-p", "explainer:=tea_leaves"], "explainer"), (["-p", "top_n:=many"], "top_n")],
)
def test_parameters_that_are_not_allowed_end_the_node_with_one_line(environment, arguments, line):
    command = ["ros2", "run", "semloc_ros", "localiser", "--ros-args", "-p", "autostart:=false", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert line in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("executable", ["localiser", "scene_graph_player"])
@pytest.mark.parametrize("after_s", [0.6, 1.2])
def test_a_signal_before_it_has_begun_ends_it_with_0(assets, environment, executable, after_s):
    ending = ["--ros-args", "-p", f"map:={assets / 'home.map'}", "-p", f"graph:={assets / 'home.json'}"]
    folder = Path(get_package_prefix("semloc_ros"))
    process = subprocess.Popen(
        [str(folder / "lib" / "semloc_ros" / executable), *ending], env=environment, stderr=subprocess.PIPE, text=True
    )
    time.sleep(after_s)  # while torch is imported, or the map is read
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
