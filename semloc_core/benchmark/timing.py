"""How contenders are timed against each other: by turns, on one thread, by the clock and by their own CPU time."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from semloc_core.metrics import Progress, Row, no_progress

T = TypeVar("T")
Times = dict[str, tuple[float, float]]
"""What was done -> seconds by the clock and the thread's own."""


def clocked(took: Times, name: str, work: Callable[[], T]) -> T:
    """What the work gives; how long it took is put into ``took`` under the name."""
    wall, own = time.perf_counter(), time.thread_time()
    result = work()
    took[name] = (time.perf_counter() - wall, time.thread_time() - own)
    return result


def is_full(text: bytes) -> bool:
    """Whether an update is a full one: these are rare, as large as the graph, and not counted."""
    return b'"full":true' in text[:400]


def held_mib(work: Callable[[], object]) -> float:
    """MiB more that Python and numpy hold when the work is done and its result still there; torch's are not seen."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        result = work()
        held = tracemalloc.get_traced_memory()[0] - before
        del result
    finally:
        tracemalloc.stop()
    return held / 2**20


@dataclass(frozen=True)
class Contender:
    """Something to time.

    Args:
        scope: the task; contenders of one task are compared.
        method: who does it; the first of a task is what the others are measured by.
        work: does it once.
        each: how many things one call does (places embedded, steps made): the figures are for one of them.
        seldom: it takes seconds: timed a tenth as often, and not tried before.

    """

    scope: str
    method: str
    work: Callable[[], object]
    each: int = 1
    seldom: bool = False


def by_turns(contenders: Sequence[Contender], repeats: int, progress: Progress = no_progress) -> list[Row]:
    """Time contenders by turns, so that all meet the same machine.

    Args:
        contenders: in the order of the rows.
        repeats: how often each is timed; once before, untimed.
        progress: told of every repeat.

    Returns:
        A row each: as of `timed_row`.

    """
    taken: list[list[tuple[float, float]]] = [[] for _ in contenders]
    for contender in contenders:
        if not contender.seldom:
            progress(0, repeats, f"warming up: {contender.method}, {contender.scope}")
            contender.work()
    took: Times = {}
    for repeat in range(repeats):
        for contender, row in zip(contenders, taken, strict=True):
            if contender.seldom and repeat >= max(1, repeats // 10):
                continue
            progress(repeat, repeats, f"{contender.method}, {contender.scope}")
            clocked(took, "", contender.work)
            wall, own = took[""]
            row.append((wall / contender.each, own / contender.each))
    firsts: dict[str, float] = {}
    rows = []
    for contender, row in zip(contenders, taken, strict=True):
        times = np.array(row)
        own_ms = float(np.median(times[:, 1]))
        rows.append(timed_row(contender.scope, contender.method, times, firsts.setdefault(contender.scope, own_ms)))
    return rows


def timed_row(scope: str, method: str, seconds: np.ndarray[tuple[int, int], np.dtype[np.float64]], first: float) -> Row:
    """One row.

    Args:
        scope: the task.
        method: the contender.
        seconds: (R, 2) by the clock and the thread's own.
        first: median own seconds of the task's first contender.

    Returns:
        ``ratio`` (this contender's ``cpu_ms`` over the first's: above 1 it is slower), ``p50_ms`` and ``p99_ms`` by
        the clock, ``cpu_ms`` (median of the thread's own time, which a busy machine lengthens less), ``repeats``.

    """
    own = float(np.median(seconds[:, 1]))
    return {
        "method": method,
        "scope": scope,
        "ratio": own / first if first > 0 else None,
        "p50_ms": 1e3 * float(np.median(seconds[:, 0])),
        "p99_ms": 1e3 * float(np.percentile(seconds[:, 0], 99)),
        "cpu_ms": 1e3 * own,
        "repeats": len(seconds),
    }
