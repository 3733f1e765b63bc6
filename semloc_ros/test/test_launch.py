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
"""The launch files: what wins, what is started again, what Ctrl-C does, and what a launch returns.

Without these, a file of parameters is overruled by defaults, a mistake in it is repeated for ever, and a replay that
failed looks like one that did not.
"""

import os
import signal
import subprocess
import threading

import pytest
from conftest import wait_for

from semloc_core.sources import BagReader, decode_string


class Launch:
    """A launch as a terminal starts it, with what it says."""

    def __init__(self, environment, file, *arguments):
        command = ["ros2", "launch", "semloc_ros", file, *arguments]
        self.lines = []
        self.process = subprocess.Popen(
            command,
            env=environment | {"PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line)

    def says(self, *texts, count=1):
        """Wait until lines with all these texts have come."""
        wait_for(
            lambda: sum(all(text in line for text in texts) for line in list(self.lines)) >= count,
            f"{texts} in {self.lines}",
            120,
        )

    def interrupt(self):
        """Press Ctrl-C: everything in the terminal gets a SIGINT, and launch sends the node another one."""
        os.killpg(self.process.pid, signal.SIGINT)

    def ended(self):
        """Wait for the end, and return its status and all that was said."""
        status = self.process.wait(120)
        self._reading.join(10)
        return status, "".join(self.lines)


@pytest.fixture
def launch(environment):
    started = []

    def start(*arguments):
        started.append(Launch(environment, *arguments))
        return started[-1]

    yield start
    for item in started:
        if item.process.poll() is None:
            os.killpg(item.process.pid, signal.SIGKILL)


def file_of(folder, **parameters):
    """Write a file of parameters."""
    lines = "".join(f"    {name}: {value}\n" for name, value in parameters.items())
    (folder / "parameters.yaml").write_text(f"/**:\n  ros__parameters:\n{lines}")
    return f"params_file:={folder / 'parameters.yaml'}"


def test_a_file_wins_over_defaults_and_an_argument_over_the_file(launch, assets, tmp_path):
    both = launch("localiser.launch.py", file_of(tmp_path, map=assets / "home.map", frame_id="filed"), "name:=filed")
    both.says("activate: inactive -> active")  # the file's map is served
    assert not any("from autostart" in line for line in both.lines)
    both.interrupt()
    assert "exit code" not in both.ended()[1]
    given = f"map:={assets / 'broken.map'}"
    argument = launch("localiser.launch.py", file_of(tmp_path, map=assets / "home.map", autostart="true"), given)
    argument.says("configure failed", "broken.map")
    argument.says("tried again in 1 s")
    argument.says("configure failed", "broken.map", count=2)
    argument.interrupt()
    assert "exit code" not in argument.ended()[1]


def test_ctrl_c_ends_the_node_in_order_though_it_comes_twice(launch, assets):
    for _ in range(3):
        run = launch("localiser.launch.py", f"map:={assets / 'home.map'}")
        run.says("activate: inactive -> active")
        run.interrupt()
        _, said = run.ended()
        assert "process has finished cleanly" in said
        assert "exit code" not in said
        assert "Traceback" not in said
        assert "SIGTERM" not in said


def test_parameters_that_are_not_allowed_are_not_tried_for_ever(launch, tmp_path):
    _, said = launch("localiser.launch.py", file_of(tmp_path, top_n=0)).ended()
    assert said.count("process started") == 1
    assert "top_n" in said
    assert "not started again: its parameters are not allowed" in said


def test_a_node_that_exits_on_failure_is_started_again(launch, assets, tmp_path):
    run = launch("localiser.launch.py", f"map:={tmp_path / 'late.map'}", "exit_on_failure:=true")
    run.says("process has died", "exit code 1")
    (tmp_path / "late.map").write_bytes((assets / "home.map").read_bytes())
    run.says("activate: inactive -> active")
    run.interrupt()
    run.ended()


def test_a_replay_returns_its_failure(launch, assets, tmp_path):
    bag, home = f"bag:={assets / 'run.mcap'}", f"map:={assets / 'home.map'}"
    status, said = launch("replay.launch.py", bag, f"map:={tmp_path / 'none.map'}").ended()
    assert status != 0
    assert "the localiser ended with status 1" in said
    status, said = launch("replay.launch.py", f"bag:={tmp_path / 'none.mcap'}", home).ended()
    assert status != 0
    assert "the bag could not be played" in said


def test_what_a_replay_records_has_the_bags_time_and_nothing_is_deprecated(launch, assets, tmp_path):
    folder = tmp_path / "answers"
    arguments = [f"bag:={assets / 'run.mcap'}", f"map:={assets / 'home.map'}", "rate:=4.0", f"record:={folder}"]
    status, said = launch("replay.launch.py", *arguments).ended()
    assert status == 0, said
    assert "eprecat" not in said
    topics = {"/localiser/matches": "std_msgs/msg/String", "/scene_graph": "std_msgs/msg/String"}
    played = list(BagReader(assets / "run.mcap", {"/scene_graph": "std_msgs/msg/String"}))
    begin, end = played[0].stamp_ns, played[-1].stamp_ns
    answers = [m for m in BagReader(folder, topics) if m.topic == "/localiser/matches"]
    assert answers
    assert all(begin <= m.stamp_ns <= end + 2_000_000_000 for m in answers)
    assert all(decode_string(m.data) for m in answers)
