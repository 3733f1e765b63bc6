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

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENES = Path(__file__).parent / "processes"


@pytest.mark.parametrize("name", ["pipeline", "robots", "swap", "bags", "hydra"])
def test_scene(assets, name, tmp_path):
    if name == "hydra":
        pytest.importorskip("hydra_msgs")
        pytest.importorskip("spark_dsg")
    found = subprocess.run(["ros2", "pkg", "executables", "semloc_ros"], capture_output=True, text=True, check=False)
    assert "semloc_ros localiser" in found.stdout, "expected the built workspace to be sourced"
    environment = os.environ | {
        "SEMLOC_TEST_ASSETS": str(assets),
        "PYTHONPATH": os.pathsep.join([str(SCENES), str(SCENES.parent), os.environ.get("PYTHONPATH", "")]),
        # A network of its own, so that no node of another test is heard.
        "ROS_DOMAIN_ID": str((int(os.environ.get("ROS_DOMAIN_ID", "0")) + 1) % 102),
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }
    command = [sys.executable, "-m", "launch_testing.launch_test", str(SCENES / f"{name}.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=420, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-8000:]
