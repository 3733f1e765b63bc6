"""Runs one localiser for long: ``python tests/soak/soak_run.py [--updates N] [--reloads N] [--seconds S]``.

A million updates that add, move and remove, with verification and the filter on, then a thousand reloads of the map;
resident memory and latency are sampled on the way, and the slope of each is printed as JSON. Exit status 1 where
memory grows.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import numpy as np  # noqa: E402
import torch  # noqa: E402
from small_building import CLASSES, building_update, delta, make_map, make_model  # noqa: E402

from semloc_core import wire  # noqa: E402
from semloc_core.config import LocaliserConfig  # noqa: E402
from semloc_core.localiser import Localiser  # noqa: E402
from semloc_core.map_database import load  # noqa: E402
from semloc_core.wire import Object, Place, SceneGraphUpdate  # noqa: E402

SAMPLES = 100
LENGTH = 12
"""Places that the robot remembers; what is kept in memory does not hang on how large its graph is."""
GROWTH_MIB = 16.0
"""What the process may grow by over the whole run, after its first tenth."""


def resident_mib() -> float:
    """Memory that the process holds now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def stream(rng: np.random.Generator) -> Iterator[SceneGraphUpdate]:
    """Without end: rooms that open ahead of the robot and are forgotten behind it, a full update now and then."""
    length, seq = LENGTH, 0
    yield building_update(length, 8)
    first = last = length
    while True:
        seq += 1
        if seq % 500 == 0:
            seq, first, last = 0, length, length
            yield building_update(length, 8)
            continue
        name, kind = f"o{1000 + seq}", seq % 4
        if kind == 0:
            place = Place(f"p{last}", (float(last), float(rng.normal(0, 0.2)), 0.0))
            yield delta(seq, query=f"p{last}", places=[place], edges=[(f"p{last - 1}", f"p{last}")])
            last += 1
        elif kind == 1:
            thing = Object(name, CLASSES[int(rng.integers(len(CLASSES)))], (float(last), 1.0, 0.0))
            yield delta(seq, query=f"p{last - 1}", objects=[thing], edges=[(f"p{last - 1}", name)])
        elif kind == 2:
            moved = Place(f"p{last - 1}", (float(last - 1), float(rng.normal(0, 0.2)), 0.0))
            yield delta(seq, query=f"p{last - 1}", places=[moved])
        else:
            gone = [f"o{1000 + seq - 20 - k}" for k in range(4)]
            gone += [f"p{first}"] if last - first > length else []
            first += last - first > length
            yield delta(seq, query=f"p{last - 1}", removed_nodes=gone)


def slope(values: list[float]) -> float:
    """Least-squares change from the first sample to the last, the first tenth left out."""
    kept = np.array(values[len(values) // 10 :])
    return float(np.polyfit(np.linspace(0, 1, len(kept)), kept, 1)[0])


def main() -> None:
    """Run, and print the slopes."""
    parser = argparse.ArgumentParser(description="Run one localiser for long.")
    parser.add_argument("--updates", type=int, default=1_000_000)
    parser.add_argument("--reloads", type=int, default=1_000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no more updates after so long")
    given = parser.parse_args()
    torch.set_num_threads(1)
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "home.map"
        make_map(path, make_model("paper"), home=building_update(60, 40))
        localiser = Localiser(load(path), LocaliserConfig(explain_rate_hz=0.2, filter="bayes"))
        updates, memory, latency = stream(np.random.default_rng(0)), [], []
        for _ in range(SAMPLES):
            own = []
            for _ in range(given.updates // SAMPLES):
                text = wire.encode(next(updates))
                began = time.thread_time()
                result = localiser.update(text)
                own.append(time.thread_time() - began)
                assert result.matches is not None
            gc.collect()
            memory.append(resident_mib())
            latency.append(1e3 * float(np.median(own)))
            if time.monotonic() - started > given.seconds:
                break
        found: dict[str, float | int] = {
            "updates": given.updates // SAMPLES * len(memory),
            "p50_ms": round(float(np.median(latency)), 3),
            "p50_change_percent": round(100 * slope(latency) / float(np.median(latency)), 1),
            "resident_mib": round(memory[-1], 1),
            "resident_change_mib": round(slope(memory), 2),
        }
        again = []
        for _ in range(given.reloads):
            fresh = Localiser(load(path), localiser.config)
            fresh.take_over(localiser)
            localiser = fresh
            localiser.update(wire.encode(next(updates)))
            again.append(resident_mib())
        found |= {"reloads": given.reloads, "reload_resident_change_mib": round(slope(again), 2) if again else 0.0}
    sys.stdout.write(json.dumps(found) + "\n")
    grown = max(found["resident_change_mib"], found["reload_resident_change_mib"])
    sys.exit(grown > GROWTH_MIB)


if __name__ == "__main__":
    main()
