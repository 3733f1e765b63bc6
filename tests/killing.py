"""Work that is killed at some moment, for the tests of what is left of it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from typing import Any


def run_and_kill(work: Callable[[int], None], seconds: float) -> list[str]:
    """Run ``work`` in a child that reports on a pipe, kill it some time after it begins; what it reported."""
    reports, end = os.pipe()
    # Forked, so that a round costs milliseconds: a fresh interpreter would spend seconds on imports.
    child = multiprocessing.get_context("fork").Process(target=work, args=(end,))
    child.start()
    os.close(end)
    assert os.read(reports, 1) == b"\n"  # it has begun
    time.sleep(seconds)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGKILL)
    child.join()
    with os.fdopen(reports) as file:
        said = file.read()
    assert child.exitcode == -signal.SIGKILL, "the work ended or failed before it could be killed"
    return said.splitlines()


def in_a_child(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What ``work`` returns, done by a process of its own."""
    ours, theirs = multiprocessing.get_context("fork").Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=lambda: theirs.send(work()))
    child.start()
    theirs.close()
    try:
        found: dict[str, Any] = ours.recv()
    finally:
        child.join()
    return found
