"""On what is timed: which machine, how busy, and one core of it."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from semloc_core.benchmark.explain import one_thread


def this_machine() -> str:
    """The processor, how many of its cores there are, and the load over the last minute."""
    name, cores = platform.processor() or platform.machine(), os.cpu_count() or 1
    about = Path("/proc/cpuinfo")
    if about.exists():
        lines = (line.partition(":") for line in about.read_text(errors="replace").splitlines())
        name = next((value.strip() for key, _, value in lines if key.strip() == "model name"), name)
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{name}, {cores} core{'s' if cores > 1 else ''}{load}"


@contextmanager
def one_core() -> Iterator[None]:
    """Run on one core, threads begun in it too, where the system can bind them to it; torch on one thread."""
    bound = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    with one_thread():
        if bound:
            os.sched_setaffinity(0, {max(bound)})
        try:
            yield
        finally:
            if bound:
                os.sched_setaffinity(0, bound)
