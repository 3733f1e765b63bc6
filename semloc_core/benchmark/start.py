"""From nothing to a first answer: fresh processes, timed by the clock, and what they hold when they are done."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from semloc_core import wire
from semloc_core.benchmark.case import BenchCase
from semloc_core.map_database import MapDatabase
from semloc_core.metrics import Progress, Row, no_progress

COMMAND = "import sys; sys.argv = ARGV; from semloc_core.cli import main; main()"
PROGRAMS = {
    "python": "pass",
    "torch, numpy: the floor": "import torch, numpy",
    "semloc: the localiser imported": "import semloc_core.localiser, semloc_core.map_database",
    "semloc: map loaded, first answer": """
from pathlib import Path
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
localiser = Localiser(load({map!r}))
assert localiser.update(Path({update!r}).read_bytes()).matches.matches""",
    "semloc --version": COMMAND.replace("ARGV", "['semloc', '--version']"),
    "semloc map info": COMMAND.replace("ARGV", "['semloc', 'map', 'info', {map!r}]"),
}
HELD = """
import sys
with open("/proc/self/status") as status:
    sys.stderr.write("held " + next(line for line in status if line.startswith("VmHWM")).split()[1])
"""


def bench_start(case: BenchCase, repeats: int = 3, progress: Progress = no_progress) -> list[Row]:
    """Time fresh processes.

    Args:
        case: gives the map and the update of the first answer.
        repeats: how often each is started.
        progress: told of every start.

    Returns:
        A row a program: ``p50_ms`` by the clock, ``cpu_ms``, the most that it held, ``peak_mib``; ``ratio`` of CPU time
        to importing torch alone.

    """
    with tempfile.TemporaryDirectory() as folder:
        path, update = Path(folder) / "office.map", Path(folder) / "update.json"
        graph = case.arrays.to_scene_graph(case.model.labelspace)
        arrays = case.arrays
        with MapDatabase.create(path, case.model) as database:
            database.add_building("office", graph, arrays.place_ids, arrays.place_positions, case.embeddings)
        at = arrays.place_ids[int(arrays.object_parents[1, 0])]
        update.write_bytes(wire.encode(graph.to_update(0, 0, "map", query_place=at)))
        names = {"map": str(path), "update": str(update)}
        took: dict[str, list[tuple[float, float, float]]] = {name: [] for name in PROGRAMS}
        for repeat in range(repeats):
            for name, program in PROGRAMS.items():
                progress(repeat, repeats, name)
                took[name].append(_start(program.format(**names)))
    found = {name: np.median(np.array(pairs), axis=0) for name, pairs in took.items()}
    floor = float(found["torch, numpy: the floor"][1])
    return [
        {
            "method": name,
            "scope": "start of a process",
            "ratio": float(own) / floor,
            "p50_ms": 1e3 * float(wall),
            "cpu_ms": 1e3 * float(own),
            "peak_mib": float(peak),
            "repeats": repeats,
        }
        for name, (wall, own, peak) in found.items()
    ]


def _start(program: str) -> tuple[float, float, float]:
    """Seconds by the clock and of CPU time, and the most memory held (MiB; Linux counts it anew for each program)."""
    text = f"import atexit\natexit.register(lambda: exec({HELD!r}))\n{program}"
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", text],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        check=True,
        text=True,
    )
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, own, int(done.stderr.rsplit("held ", 1)[1]) / 1024
