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
"""A localiser as a process of its own: no order of valid calls ends it, and it says what it can't do.

Without these, a lifecycle manager's first call ends the node, or a cleanup while somebody waits for an answer.
"""

import random
import signal
import subprocess
import sys
import time

import building
import pytest
from builtin_interfaces.msg import Time
from conftest import PATIENCE_S, Client, wait_for
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED,
    State.PRIMARY_STATE_INACTIVE,
    State.PRIMARY_STATE_ACTIVE,
)
LEADS_TO = {
    (UNCONFIGURED, CONFIGURE): INACTIVE,
    (INACTIVE, ACTIVATE): ACTIVE,
    (ACTIVE, DEACTIVATE): INACTIVE,
    (INACTIVE, CLEANUP): UNCONFIGURED,
}


class Running(Client):
    """A localiser's process and the other end of its topics and services."""

    def __init__(self, node, process):
        super().__init__(node)
        self.process = process
        self.clients = {}

    def start_call(self, kind, service, request):
        """Call a service; the answer is awaited by who needs it."""
        if service not in self.clients:
            self.clients[service] = self.node.create_client(kind, f"{self.name}/{service}")
        assert self.clients[service].wait_for_service(PATIENCE_S), service
        return self.clients[service].call_async(request)

    def answer(self, future, what):
        """What a service answers."""
        wait_for(lambda: future.done() or self.process.poll() is not None, f"the answer to {what}", 150)
        assert self.process.poll() is None, f"{what} ended the node"
        return future.result()

    def wait_until_up(self):
        """Ask until the process answers: a node of another test may still be listed, and is asked in vain."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            future = self.start_call(GetState, "get_state", GetState.Request())
            asked = time.monotonic()
            while time.monotonic() < asked + 2.0:
                if future.done():
                    return
                assert self.process.poll() is None, "the node ended at once"
                time.sleep(0.02)
            self.clients["get_state"].remove_pending_request(future)
        raise AssertionError("the node does not answer")

    def state(self):
        """The id of the node's state."""
        return self.answer(self.start_call(GetState, "get_state", GetState.Request()), "get_state").current_state.id

    def ask_change(self, transition=0, label=""):
        """Ask for a transition by id or label."""
        wanted = Transition(id=transition, label=label)
        return self.start_call(ChangeState, "change_state", ChangeState.Request(transition=wanted))

    def change(self, transition=0, label=""):
        """Whether a transition succeeded."""
        return self.answer(self.ask_change(transition, label), f"transition {transition}{label}").success

    def ask(self, service):
        """Call a Trigger service."""
        return self.start_call(Trigger, service, Trigger.Request())

    def ask_set(self, name, value):
        """Set a parameter."""
        wanted = [Parameter(name, value=value).to_parameter_msg()]
        return self.start_call(SetParameters, "set_parameters", SetParameters.Request(parameters=wanted))


@pytest.fixture
def running(spin, assets):
    """Start a localiser's process; it ends with 0 when the test is over, or the test has failed."""
    import rclpy

    started = []

    def make(before="", **parameters):
        values = {"map": str(assets / "home.map"), "autostart": False, "stale_after_s": 1.0} | parameters
        begin = "import sys; from semloc_ros.commands import localiser; sys.exit(localiser())"
        command = [sys.executable, "-c", before + begin, "--ros-args"]
        for name, value in values.items():
            command += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        side = Running(spin(rclpy.create_node("test_client")), process)
        started.append(side)
        side.wait_until_up()
        return side

    yield make
    for side in started:
        if side.process.poll() is None:
            side.process.send_signal(signal.SIGINT)
        _, errors = side.process.communicate(timeout=60)
        assert side.process.returncode == 0, errors
        assert "Traceback" not in errors, errors


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def test_a_transition_that_the_state_does_not_allow_is_refused_and_the_node_lives(running):
    side = running()
    assert side.state() == UNCONFIGURED
    for wanted in (CLEANUP, ACTIVATE, DEACTIVATE, 7, 99, 255, 10):
        assert not side.change(wanted)
    assert side.change(CONFIGURE)
    assert side.change(ACTIVATE)
    for wanted in (CONFIGURE, CLEANUP, ACTIVATE, 5, 6, 99, 0):
        assert not side.change(wanted)
    for label in ("configure", "activate", "nonsense", "transition_success"):
        assert not side.change(label=label)
    assert side.state() == ACTIVE
    assert side.change(label="deactivate")
    assert not side.change(DEACTIVATE)
    assert side.change(6)  # shut down
    assert side.state() == State.PRIMARY_STATE_FINALIZED
    for wanted in (CONFIGURE, ACTIVATE, 5, 6, 7):
        assert not side.change(wanted)


def test_a_lifecycle_managers_first_configure_takes_a_node_over_that_started_itself(running):
    # As nav2_lifecycle_manager does it: each transition, then whether the state is the one it leads to.
    side = running(autostart=True)
    wait_for(lambda: side.state() == ACTIVE, "it to start itself")
    assert side.change(CONFIGURE)
    assert side.state() == INACTIVE
    assert side.change(ACTIVATE)
    assert side.state() == ACTIVE
    assert not side.change(CONFIGURE)  # only the first
    assert side.state() == ACTIVE
    side.connect().send(updates()[0])
    side.wait_matches(1)


def test_a_signal_that_another_thread_is_given_ends_it(running, tmp_path):
    """The system gives a process's signal to any thread; the one that waits for it would sleep on."""
    told = tmp_path / "told"
    thread = (
        "import os, signal, threading, time\n"
        "def wait():\n"
        f"    while not os.path.exists({str(told)!r}):\n"
        "        time.sleep(0.05)\n"
        "    signal.pthread_kill(threading.get_ident(), signal.SIGINT)\n"
        "    time.sleep(100)\n"
        "threading.Thread(target=wait, daemon=True).start()\n"
    )
    side = running(thread)
    told.touch()
    side.process.wait(timeout=60)
    assert side.process.returncode == 0


@pytest.mark.parametrize("service", ["explain", "reload_map", "reset"])
def test_a_cleanup_while_a_service_call_is_open_answers_it(running, service):
    side = running(explainer="class_shapley")
    for _ in range(3):
        for wanted in (CONFIGURE, ACTIVATE):
            assert side.change(wanted)
        side.connect().send(updates()[0])
        side.wait_matches(1)
        open_call = side.ask(service)
        for wanted in (DEACTIVATE, CLEANUP):
            assert side.change(wanted)
        side.answer(open_call, service)
    assert not side.answer(side.ask(service), service).success  # it is unconfigured, and says so


@pytest.mark.parametrize("seed", range(2))
def test_any_order_of_valid_calls_at_any_time(running, assets, seed):
    rng, side, expected = random.Random(seed), running(), UNCONFIGURED
    run = [*updates(full_every_s=1.0), "garbage", "{}"]
    values = [("top_n", 3), ("top_n", 0), ("map", str(assets / "both.map")), ("map", "/nowhere"), ("top_n", "many")]
    values += [("explainer", "attention"), ("frame_id", "home"), ("autostart", True), ("use_sim_time", "x"), ("no", 1)]
    open_calls = []
    for _ in range(120):
        kind = rng.choices(["change", "ask", "set", "update", "request"], [4, 3, 2, 8, 1])[0]
        if kind == "change":
            wanted = rng.choice([CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP, 99])
            leads_to = LEADS_TO.get((expected, wanted))
            assert side.change(wanted) == (leads_to is not None)
            expected = leads_to or expected
            assert side.state() == expected
        elif kind == "ask":
            service = rng.choice(["explain", "reset", "reload_map"])
            open_calls.append((side.ask(service), service))
        elif kind == "set":
            name, value = rng.choice(values)
            if (name, value) != ("map", "/nowhere") or expected != UNCONFIGURED:  # else it is found out later
                open_calls.append((side.ask_set(name, value), name))
        elif kind == "request":
            side.request('{"schema":"semloc/explain_request/1","stamp_ns":0,"frame_id":"","seq":1}')
        else:
            side.send(rng.choice(run))
        if rng.random() < 0.2:
            while open_calls:
                side.answer(*open_calls.pop())
    while open_calls:
        side.answer(*open_calls.pop())
    for wanted in {UNCONFIGURED: [CONFIGURE, ACTIVATE], INACTIVE: [ACTIVATE], ACTIVE: []}[expected]:
        assert side.change(wanted)
    side.connect().send(run[0])
    before = len(side.seen["/localiser/matches"])
    side.wait_matches(before + 1)


def test_a_clock_before_1970_costs_its_message_and_not_the_node(running):
    # rclpy's own callback raises on it: whatever a callback raises, the others go on.
    side = running(autostart=True, use_sim_time=True)
    clock = side.node.create_publisher(Clock, "/clock", 10)
    wait_for(clock.get_subscription_count, "the clock's subscriber")
    wait_for(lambda: side.state() == ACTIVE, "it to start itself")
    for seconds in (100, -1, -(2**31), 2**31 - 1, 0, -5):
        clock.publish(Clock(clock=Time(sec=seconds)))
        assert side.state() == ACTIVE
    side.connect().send(updates()[0])
    side.wait_matches(1)


def test_what_the_core_logs_goes_to_the_ros_logger(spin, capfd):
    import logging

    import rclpy
    from semloc_ros.running import RosLog

    logger, handler = logging.getLogger("semloc_core.some_module"), RosLog(spin(rclpy.create_node("speaker")))
    logger.addHandler(handler)
    try:
        for level in (logging.WARNING, logging.ERROR):  # one after the other: rclpy has a severity a line of code
            logger.log(level, "the map is %s", "odd")
    finally:
        logger.removeHandler(handler)
    said = capfd.readouterr().err
    for level in ("WARN", "ERROR"):
        assert any(f"[{level}]" in line and "[speaker]: the map is odd" in line for line in said.splitlines())
