#!/usr/bin/env python3
"""How long the node takes from its start to its first answer, and the memory that it holds at rest.

Run in a shell where ROS 2 and the workspace are sourced:
    python tools/ros_start.py --map MAP --run RUN [--starts N] [--json FILE]

Each start is a fresh process. ``listening``: it subscribes and publishes; ``answered``: the first update of RUN, a full
one, is sent then, and its answer has come. Clock and CPU seconds (user and system, all threads) since the process was
made. ``floor``: an interpreter that imports torch, numpy and rclpy and makes an empty node. MiB are resident memory.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from semloc_core.errors import SemlocError
from semloc_core.files import FIGURES, Output, guarded, write_whole
from semloc_core.metrics import document
from semloc_core.sources import read_run
from semloc_ros import qos

FLOOR = "import torch, numpy, rclpy; rclpy.init(); rclpy.create_node('floor'); print('up', flush=True); input()"
PATIENCE_S = 60.0


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, required=True)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--force", action="store_true", help="replace figures that are there")
    options = parser.parse_args()
    wanted = [Output("--json", options.json, FIGURES)] if options.json is not None else []
    try:
        with guarded(wanted, [options.map, options.run], force=options.force):
            measure(options)
    except SemlocError as error:
        parser.error(str(error))


def measure(options: argparse.Namespace) -> None:
    """Everything, with its figures."""
    first = next(iter(read_run(options.run))).text
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    figures = {"floor": middle([floor() for _ in range(options.starts)])}
    figures["node"] = middle([start(options.map, first) for _ in range(options.starts)])
    rclpy.try_shutdown()
    for name, values in figures.items():
        sys.stdout.write(f"{name}: " + ", ".join(f"{key} {value:.2f}" for key, value in values.items()) + "\n")
    if options.json is not None:
        rows = [{"method": name, "scope": "start", **values} for name, values in figures.items()]
        write_whole(options.json, document("ros_start", 0, [options.map.name, options.run.name], rows))


def middle(runs: list[dict[str, float]]) -> dict[str, float]:
    """Medians."""
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def floor() -> dict[str, float]:
    """What no node can do without."""
    begun = time.monotonic()
    process = subprocess.Popen([sys.executable, "-c", FLOOR], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdout.readline()
    found = {"up_s": time.monotonic() - begun, "up_cpu_s": cpu_s(process.pid), "MiB": resident_mib(process.pid)}
    process.kill()
    process.wait()
    process.stdin.close()
    return found


def start(map_file: Path, update: str) -> dict[str, float]:
    """One start of the node."""
    here = rclpy.create_node("start")
    answered = threading.Event()
    publisher = here.create_publisher(String, "scene_graph", qos.UPDATES)
    here.create_subscription(String, "/localiser/matches", lambda _: answered.set(), qos.ANSWERS)
    executor = SingleThreadedExecutor()
    executor.add_node(here)
    command = [sys.executable, "-c", "import sys; from semloc_ros.commands import localiser; sys.exit(localiser())"]
    command += ["--ros-args", "-p", f"map:={map_file.resolve()}"]
    begun = time.monotonic()
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        wait(executor, process, lambda: publisher.get_subscription_count() and listening(here))
        found = {"listening_s": time.monotonic() - begun, "listening_cpu_s": cpu_s(process.pid)}
        found["at_rest_MiB"] = resident_mib(process.pid)
        sent, before = time.monotonic(), cpu_s(process.pid)
        publisher.publish(String(data=update))
        wait(executor, process, answered.is_set)
        found |= {"answered_after_s": time.monotonic() - sent, "answered_after_cpu_s": cpu_s(process.pid) - before}
        found["answered_MiB"] = resident_mib(process.pid)
        return found
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        process.wait(PATIENCE_S)
        executor.shutdown()
        here.destroy_node()


def listening(here: Node) -> bool:
    """Whether answers are published."""
    return here.count_publishers("/localiser/matches") > 0


def wait(executor: SingleThreadedExecutor, process: subprocess.Popen[bytes], done: object) -> None:
    """Spin until ``done()``."""
    assert callable(done)
    until = time.monotonic() + PATIENCE_S
    while not done():
        executor.spin_once(timeout_sec=0.01)
        if process.poll() is not None:
            raise RuntimeError(f"expected a localiser that runs (got status {process.returncode})")
        if time.monotonic() > until:
            raise RuntimeError(f"expected an answer within {PATIENCE_S:g} s (got none)")


def cpu_s(pid: int) -> float:
    """User and system seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mib(pid: int) -> float:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main()
