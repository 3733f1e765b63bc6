"""Work that is killed at some moment, for the tests of what is left of it.

A moment is a number of function calls that the work has made, in Python and of what is written in C: the same on a
slow machine as on a fast one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


class Calls:
    """Counts the calls and returns of this thread, and does something at one of them; once `Calls.begin` is called.

    Args:
        at: at which of them; 0 is at once.
        then: what is done.
        within: only what files whose path holds this do is counted.

    """

    def __init__(self, at: float, then: Callable[[], None], within: str = "") -> None:
        self.made, self._at, self._then, self._within = 0, at, then, within

    def begin(self) -> None:
        if self._at <= 0:
            self._then()
        else:
            sys.setprofile(self._count)

    def end(self) -> int:
        sys.setprofile(None)
        return self.made

    def _count(self, frame: FrameType, _: str, __: Any) -> None:
        if self._within in frame.f_code.co_filename:
            self.made += 1
            if self.made == self._at:
                sys.setprofile(None)
                self._then()


class Work:
    """What work that is to be killed calls.

    Args:
        calls: counts its calls.
        reports: where its reports go.

    """

    def __init__(self, calls: Calls, reports: int) -> None:
        self._calls, self._reports = calls, reports

    def begun(self) -> None:
        """Calls are counted from here."""
        self._calls.begin()

    def report(self, line: str) -> None:
        os.write(self._reports, f"{line}\n".encode())


def kill_oneself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def run_and_kill(work: Callable[[Work], None], at: float, *, just_there: bool = True) -> list[str]:
    """Run ``work`` in a child that is killed at the ``at``-th call after it has begun, or else when it has ended.

    Args:
        work: is done with what it begins and reports by.
        at: the number of the call.
        just_there: the child dies in that call. Without it, it goes on until the kill comes from here: wherever it is
            by then, in the middle of what is written in C too.

    Returns:
        What it reported.

    """
    reports, written = os.pipe()
    signs, given = os.pipe()

    def child() -> None:
        calls = Calls(at, kill_oneself if just_there else lambda: _sign(given))
        work(Work(calls, written))
        calls.end()
        _sign(given)
        while True:
            signal.pause()  # to be killed

    # Forked, so that a round costs milliseconds: a fresh interpreter would spend seconds on imports.
    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    os.close(written)
    os.close(given)
    os.read(signs, 1)  # it is there, has ended, or is dead
    os.close(signs)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with os.fdopen(reports) as file:
        said = file.read()
    assert process.exitcode == -signal.SIGKILL, "the work failed before it could be killed"
    return said.splitlines()


def calls_of(work: Callable[[Work], None]) -> int:
    """How many calls ``work`` makes from where it has begun to its end."""

    def whole(given: Work) -> None:
        work(given)
        given.report(f"calls {given._calls.end()}")

    return int(run_and_kill(whole, float("inf"))[-1].removeprefix("calls "))


def _sign(to: int) -> None:
    os.write(to, b".")


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
