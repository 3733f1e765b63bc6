"""Fuzzes one target or all: ``python tests/fuzz/fuzz_run.py [TARGET …] [--seconds S | --count N] [--seed N]``.

Inputs are damaged seeds, the same for the same seed. An input that raises what it must not, hangs or takes too much
memory is kept under ``out/fuzz/<target>``; put it into ``tests/fuzz/regressions/<target>`` and it is tried by every
test run. ``--engine atheris`` (an extra, ``semloc[fuzz]``) is guided by coverage of semloc_core instead, and keeps
its corpus there from run to run, beginning with ``tests/fuzz/corpus``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import resource
import signal
import sys
import tempfile
import time
import zipfile
import zlib
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "fuzz")]

HANG_S = 20  # of one input's own CPU time
BYTES_PER_INPUT_BYTE, FLOOR_BYTES = 64, 64 * 2**20
"""What a process may grow by: so much for a byte of its largest input, and what caches take. Beyond: a fault.

A bag may take its record limit besides (`semloc_core.sources.bag.mcap_stream.MAX_RECORD_BYTES`)."""


LONGEST_BYTES = 2**20
UNREADABLE = (ValueError, LookupError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error)
"""What the mutators of `fuzz_targets` raise where an input is too far from its format."""


class HangError(AssertionError):
    """One input took too long."""


def peak_bytes() -> int:
    """The most that this process ever held."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def fuzz(
    target: Any, rng: random.Random, seconds: float = 0, count: int = 0, keep: Path | None = None
) -> dict[str, Any]:
    """Feed a target until time or count is up.

    Returns:
        Figures: ``inputs``, ``taken`` and ``refused``, the slowest input, growth of the process.

    Raises:
        AssertionError: a fault; its input is in ``keep``.

    """
    began, tried, largest, slowest = time.monotonic(), 0, 0, 0.0
    for seed in target.seeds:  # imports and caches are not growth
        target(seed)
    target.counts.clear()
    before = peak_bytes()

    def too_long(_: int, __: FrameType | None) -> None:
        raise HangError(f"more than {HANG_S} s")

    previous = signal.signal(signal.SIGVTALRM, too_long)
    try:
        while tried < count or time.monotonic() - began < seconds:
            data = target.mutate(rng.choice(target.seeds), rng)
            largest = max(largest, len(data))
            own = time.process_time()
            signal.setitimer(signal.ITIMER_VIRTUAL, HANG_S)
            try:
                target(data)
                allowed = BYTES_PER_INPUT_BYTE * largest + FLOOR_BYTES
                assert peak_bytes() - before <= allowed, f"more memory than {allowed} bytes"
            except KeyboardInterrupt:
                raise
            except BaseException:
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
                raise
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            tried, slowest = tried + 1, max(slowest, time.process_time() - own)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; so far:\n")
    finally:
        signal.signal(signal.SIGVTALRM, previous)
    return {
        "inputs": tried,
        **dict(sorted(target.counts.items())),
        "per_second": round(tried / (time.monotonic() - began)),
        "slowest_ms": round(1e3 * slowest, 1),
        "largest_bytes": largest,
        "growth_mib": round((peak_bytes() - before) / 2**20, 1),
    }


def by_coverage(name: str, seconds: float, corpus: Path, seed: int = 0) -> None:
    """Run atheris on a target; it ends the process."""
    import logging

    import atheris  # type: ignore[import-not-found,import-untyped,unused-ignore]

    logging.disable(logging.ERROR)

    with atheris.instrument_imports(include=["semloc_core"]):
        from fuzz_targets import TARGETS
    corpus.mkdir(parents=True, exist_ok=True)
    target = TARGETS[name](Path(tempfile.mkdtemp()))
    for each in [*target.seeds, *(path.read_bytes() for path in (CORPUS / name).glob("*"))]:
        (corpus / hashlib.sha256(each).hexdigest()[:16]).write_bytes(each)

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.5:
            try:
                return bytes(target.mutate(data, rng)[:max_size])
            except UNREADABLE:  # bytes alone reach what comes before the format is understood
                pass
        return bytes(atheris.Mutate(data, max_size))

    options = [sys.argv[0], str(corpus), f"-max_total_time={int(seconds)}", f"-timeout={HANG_S}", "-rss_limit_mb=2048"]
    options += [f"-max_len={LONGEST_BYTES}", f"-artifact_prefix={corpus.parent}/{name}-", f"-seed={seed + 1}"]
    atheris.Setup(options, target, custom_mutator=mutate)
    atheris.Fuzz()


def main() -> None:
    """Fuzz what was asked for, one line of figures a target."""
    parser = argparse.ArgumentParser(description="Fuzz what reads what others wrote.")
    parser.add_argument("targets", nargs="*", metavar="TARGET")
    parser.add_argument("--seconds", type=float, default=0, help="for each target")
    parser.add_argument("--count", type=int, default=0, help="inputs for each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", choices=("damage", "atheris"), default="damage")
    given = parser.parse_args()
    if given.engine == "atheris":
        by_coverage(given.targets[0], given.seconds, ROOT / "out" / "fuzz" / "corpus" / given.targets[0], given.seed)
    import logging

    import torch
    from fuzz_targets import TARGETS

    torch.set_num_threads(1)
    logging.disable(logging.ERROR)
    for name in given.targets or TARGETS:
        with tempfile.TemporaryDirectory() as folder:
            keep = ROOT / "out" / "fuzz" / name
            found = fuzz(TARGETS[name](Path(folder)), random.Random(given.seed), given.seconds, given.count, keep)
        sys.stdout.write(json.dumps({"target": name, "seed": given.seed, **found}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
