#!/usr/bin/env python3
"""Load on the node, with real processes: latency from update to match, drops, memory, explanations on and off.

Run in a shell where ROS 2 and the workspace are sourced:
    python tools/ros_load.py --map MAP --run RUN [--json FILE] [--memory UPDATES]

RUN is a bag of updates, best of a graph of about 1,500 places (`semloc bag simulate`). It is sent as deltas; each
answer's latency is from just before its update was published until it was received, by one clock in one process.
``inside`` is what the node itself says (`latency_ms`): from the update's arrival in its queue until the answer is
there. ``share_ros`` of the median is transport and executor, ``share_json`` reading updates and writing answers. The
core's own latency, and the time it takes over JSON, are measured on the same updates, at the same rate, in a process
of its own. A rate is ``held`` if every update is applied and 99 % of them are answered for themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from semloc_core import wire
from semloc_core.errors import SemlocError
from semloc_core.files import FIGURES, Output, guarded, write_whole
from semloc_core.metrics import document
from semloc_core.sources import read_run
from semloc_ros import qos

CORE = """
import json, sys, time
import torch
torch.set_num_threads(1)
from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
localiser = Localiser(load(sys.argv[1]), LocaliserConfig(explain_rate_hz=0, **json.loads(sys.argv[2])))
taken = []
for text in sys.stdin:
    time.sleep(0.1)  # as often as the node is asked: caches and clock rates are then the same
    times = [time.perf_counter()]
    update = wire.decode_update(text)
    times.append(time.perf_counter())
    matches = localiser.update(update).matches
    times.append(time.perf_counter())
    wire.encode(matches)
    times.append(time.perf_counter())
    taken.append([1e3 * (b - a) for a, b in zip(times, times[1:])])
print(json.dumps(taken))
"""


HELD = 0.99
"""A rate is held if every update is applied and this share of them is answered for itself."""


class Load:
    """A localiser process, a publisher and a subscriber."""

    def __init__(
        self, map_file: Path, explain_rate_hz: float, explainer: str = "attention", others: dict[str, Any] | None = None
    ) -> None:
        self.node = rclpy.create_node("load")
        self.sent: dict[int, float] = {}
        self.latency: dict[int, float] = {}
        self.inside: dict[int, float] = {}
        self.attributions = 0
        self.values: dict[str, str] = {}
        self._publisher = self.node.create_publisher(String, "scene_graph", qos.UPDATES)
        self.node.create_subscription(String, "/localiser/matches", self._on_matches, qos.ANSWERS)
        self.node.create_subscription(String, "/localiser/attributions", self._on_attributions, qos.ANSWERS)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.LATEST)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        # Not `ros2 run`, so that the process that is measured is the node's own.
        command = [sys.executable, "-c", "import sys; from semloc_ros.commands import localiser; sys.exit(localiser())"]
        command += ["--ros-args", "-p", f"map:={map_file.resolve()}"]
        command += ["-p", f"explain_rate_hz:={float(explain_rate_hz)}", "-p", f"explainer:={explainer}"]
        for name, value in (others or {}).items():
            command += ["-p", f"{name}:={value}"]
        self.process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
        try:
            while not (self._publisher.get_subscription_count() and self.node.count_publishers("/localiser/matches")):
                if self.process.poll() is not None:
                    raise RuntimeError(f"expected a localiser that runs (got status {self.process.returncode})")
                time.sleep(0.05)
            time.sleep(2.0)
        except BaseException:  # a thread that still spins when the interpreter ends aborts it
            self.close()
            raise

    def close(self) -> None:
        """End all, in order."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
        status = self.process.wait(60)
        self._ended.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        if status:
            raise RuntimeError(f"expected the node to end with 0 after SIGINT (got {status})")

    def _spin(self) -> None:
        # Not `spin`: the executor's shutdown would free what it still uses.
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def send(self, seq: int, text: str) -> None:
        """Publish an update and note when."""
        self.sent[seq] = time.perf_counter()
        self._publisher.publish(String(data=text))

    def _on_matches(self, message: String) -> None:
        now = time.perf_counter()
        answer = wire.decode(message.data, wire.PlaceMatches)
        self.latency[answer.seq] = 1e3 * (now - self.sent[answer.seq])
        assert answer.latency_ms is not None
        self.inside[answer.seq] = answer.latency_ms

    def _on_attributions(self, _: String) -> None:
        self.attributions += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("localisation"):
                self.values = {pair.key: pair.value for pair in status.values}

    def settle(self, received: int, patience_s: float = 20.0) -> None:
        """Wait until the node has received so many updates, or no more come: some were overwritten."""
        most, end = 0, time.monotonic() + patience_s
        while most < received and time.monotonic() < end:
            time.sleep(0.1)
            if (now := int(self.values.get("updates received", 0))) > most:
                most, end = now, time.monotonic() + patience_s

    def resident_mib(self) -> float:
        """Resident memory of the node's process (not of the explaining one)."""
        for line in Path(f"/proc/{self.process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) / 1024
        raise RuntimeError("expected VmRSS of a running process (got none)")


def deltas(run: Path) -> list[wire.SceneGraphUpdate]:
    """A run's updates, decoded."""
    return [wire.decode_update(item.text) for item in read_run(run)]


def endless(updates: list[wire.SceneGraphUpdate], count: int) -> Any:
    """So many updates: the run, then to and fro over its query places as deltas that move an object a little."""
    last = updates[-1]
    places = list(dict.fromkeys(u.query_place for u in updates if u.query_place))
    objects = list({o.id: o for u in updates for o in u.objects}.values())
    gone = {node for u in updates for node in u.removed_nodes}
    objects = [o for o in objects if o.id not in gone]
    for i in range(count):
        if i < len(updates):
            yield msgspec.structs.replace(updates[i], seq=i)
            continue
        item = objects[i % len(objects)]
        x, y, z = item.position
        moved = msgspec.structs.replace(item, position=(x + 0.05 * (i % 3), y, z))
        yield wire.SceneGraphUpdate(
            schema=last.schema,
            stamp_ns=last.stamp_ns + (i - len(updates) + 1) * 100_000_000,
            frame_id=last.frame_id,
            seq=i,
            full=False,
            places=[],
            objects=[moved],
            edges=[],
            query_place=places[i % len(places)],
        )


def steady(
    map_file: Path, updates: list[wire.SceneGraphUpdate], hz: float, seconds: float, **node: Any
) -> tuple[dict[str, Any], list[float], list[float]]:
    """Updates at a steady rate for a while: what came of them, and latencies from outside and from inside."""
    count = round(hz * seconds)
    texts = [wire.encode(u).decode() for u in endless(updates, count)]
    load = Load(map_file, **node)
    try:
        begin = time.perf_counter()
        for i, text in enumerate(texts):
            while (left := begin + i / hz - time.perf_counter()) > 0:
                time.sleep(min(left, 0.05))
            load.send(i, text)
        load.settle(count)
        counts = {
            "updates": count,
            "received": int(load.values["updates received"]),
            "applied": int(load.values["updates applied"]),
            "gaps": int(load.values["gaps in the stream"]),
            "answers": len(load.latency),
            "attributions": load.attributions,
            "late": int(load.values["explanations late (attention instead)"]),
        }
        return counts, list(load.latency.values()), list(load.inside.values())
    finally:
        load.close()


def pooled(runs: list[tuple[dict[str, Any], list[float], list[float]]]) -> dict[str, Any]:
    """One row of several runs."""
    outside, inside = (np.concatenate([run[k] for run in runs]) for k in (1, 2))
    row: dict[str, Any] = {key: sum(run[0][key] for run in runs) for key in runs[0][0]}
    for name, values in (("", outside), ("inside_", inside)):
        row |= {f"{name}p50_ms": float(np.percentile(values, 50)), f"{name}p99_ms": float(np.percentile(values, 99))}
    return row


def memory(
    map_file: Path, updates: list[wire.SceneGraphUpdate], total: int, others: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Resident memory after 1,000 updates and after many more, as fast as the node takes them."""
    load, early = Load(map_file, 5.0, others=others), 0.0
    try:
        begin = time.perf_counter()
        for i, update in enumerate(endless(updates, total)):
            load.send(i, wire.encode(update).decode())
            if i % 200 == 199:
                load.sent = {k: v for k, v in load.sent.items() if k > i - 5000}
                load.latency.clear(), load.inside.clear()
                while (
                    i - int(load.values.get("updates received", 0)) > 600
                ):  # with the 200 to come, below the 1,000 that are kept
                    time.sleep(0.02)
            if i == 999:
                load.settle(1000)
                early = load.resident_mib()
        load.settle(total)
        seconds = time.perf_counter() - begin
        return {
            "updates": total,
            "applied": int(load.values["updates applied"]),
            "resident_mib_1000": early,
            "resident_mib": load.resident_mib(),
            "updates_per_s": total / seconds,
        }
    finally:
        load.close()


def show(row: dict[str, Any]) -> None:
    """One row on screen as soon as it is there."""
    sys.stdout.write(json.dumps({k: round(v, 2) if isinstance(v, float) else v for k, v in row.items()}) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Measure, print, and write the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, required=True)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run at 10 Hz")
    parser.add_argument("--rounds", type=int, default=3, help="how often each run at 10 Hz is made; 0 leaves them out")
    parser.add_argument("--rates", type=float, nargs="*", default=[20.0, 30.0, 40.0, 60.0], help="tried in turn")
    parser.add_argument("--minute", type=float, default=60.0, help="seconds that each rate is tried for")
    parser.add_argument("--memory", type=int, default=0, metavar="UPDATES", help="also measure memory over so many")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="other options of the localiser")
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
    """Everything that is asked for, with its figures."""
    # Ctrl-C is Python's: ROS's handler would end the context under the thread that spins.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    updates = deltas(options.run)
    texts = "\n".join(wire.encode(u).decode() for u in endless(updates, round(10 * options.seconds)))
    others = {name: yaml.safe_load(value) for name, value in (item.split("=", 1) for item in options.set)}
    command = [sys.executable, "-c", CORE, str(options.map), json.dumps(others)]
    rows: list[dict[str, Any]] = []
    taken: list[list[float]] = []
    modes = {
        "explanations off": {"explain_rate_hz": 0.0},
        "attention 5 Hz": {"explain_rate_hz": 5.0},
        "class_shapley 5 Hz": {"explain_rate_hz": 5.0, "explainer": "class_shapley"},
    }
    # In turns, so that whatever else the machine does falls on all of them.
    runs: dict[str, list[Any]] = {scope: [] for scope in modes}
    for _ in range(options.rounds):
        core = subprocess.run(command, input=texts, stdout=subprocess.PIPE, check=True, text=True)
        taken += json.loads(core.stdout)
        for scope, node in modes.items():
            runs[scope].append(steady(options.map, updates, 10.0, options.seconds, others=others, **node))
    decode_ms, encode_ms = 0.0, 0.0
    if taken:
        median, high = np.percentile(np.sum(taken, axis=1), [50, 99]).tolist()
        decode_ms, _, encode_ms = np.median(taken, axis=0).tolist()
        json_ms = {"decode_p50_ms": decode_ms, "encode_p50_ms": encode_ms}
        rows.append({"method": "core", "scope": "10 Hz", "updates": len(taken), "p50_ms": median, "p99_ms": high})
        rows[-1] |= json_ms
        show(rows[-1])
    for scope, found in runs.items():
        if found:
            row = pooled(found)
            # From within, the clock runs from an update's arrival until its answer is there, not yet written as JSON.
            row["share_ros"] = (row["p50_ms"] - row["inside_p50_ms"] - encode_ms) / row["p50_ms"]
            row["share_json"] = (decode_ms + encode_ms) / row["p50_ms"]
            row["ratio"] = row["p99_ms"] / rows[1]["p99_ms"] if len(rows) > 1 else 1.0
            rows.append({"method": "node", "scope": f"10 Hz, {scope}"} | row)
            show(rows[-1])
    for rate in options.rates:
        row = pooled([steady(options.map, updates, rate, options.minute, explain_rate_hz=5.0, others=others)])
        row["held"] = row["applied"] == row["updates"] and row["answers"] >= HELD * row["updates"]
        rows.append({"method": "node", "scope": f"{rate:g} Hz, attention 5 Hz", "rate_hz": rate} | row)
        show(rows[-1])
    held = [row["rate_hz"] for row in rows if row.get("held")]
    if options.rates:
        rows.append({"method": "node", "scope": "highest rate held", "rate_hz": max(held, default=0.0)})
        show(rows[-1])
    if options.memory:
        rows.append({"method": "node", "scope": "memory"} | memory(options.map, updates, options.memory, others))
        show(rows[-1])
    rclpy.try_shutdown()
    if options.json is not None:
        write_whole(options.json, document("ros_load", 0, [options.map.name, options.run.name, *options.set], rows))


if __name__ == "__main__":
    main()
