"""What ``semloc replay`` prints while it runs: an answer a second, marked where it is wrong."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from semloc_core.text import percent

if TYPE_CHECKING:
    from semloc_core.replay import Answer
    from semloc_core.sources import Truth
    from semloc_core.wire import ClassAttributions, PlaceMatches, Position

SECOND_NS = 1_000_000_000
UNTOLD, TOLD = 3, 100
"""Lines that wait for the true pose at most: in a run that has told none so far, and in one that has."""


@dataclass
class _Line:
    matches: PlaceMatches
    said: str
    why: str


class Lines:
    """Prints an answer a second of the run, as soon as it is known whether it is right.

    Args:
        show: prints a line.

    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._first_ns: int | None = None
        self._last_ns = 0
        self._waiting: deque[_Line] = deque()
        self._most = UNTOLD

    def answer(self, answer: Answer) -> None:
        """Take an answer in."""
        stamp = answer.matches.stamp_ns
        if self._first_ns is not None and 0 <= stamp - self._last_ns < SECOND_NS:
            return
        self._first_ns = stamp if self._first_ns is None else self._first_ns
        self._last_ns = stamp
        self._waiting.append(_line(answer, (stamp - self._first_ns) / SECOND_NS))
        while len(self._waiting) > self._most:
            self._print()

    def scored(self, matches: PlaceMatches, truth: Truth | None, right: bool | None) -> None:
        """Say whether an answer is right: see `semloc_core.replay.Scored`."""
        if truth is not None:
            self._most = TOLD
        if any(line.matches is matches for line in self._waiting):
            while self._waiting[0].matches is not matches:
                self._print()
            self._print(_mark(matches, truth, right))

    def finish(self) -> None:
        """Print what still waits."""
        while self._waiting:
            self._print()

    def _print(self, mark: str = "") -> None:
        line = self._waiting.popleft()
        self._show(f"{line.said}{mark}{line.why}")


def _mark(matches: PlaceMatches, truth: Truth | None, right: bool | None) -> str:
    """What is said of an answer that names a place which is not right; a ``match`` that is not is an error."""
    if truth is None or right or not matches.matches:
        return ""
    if right is None:
        return f"  (truly in {truth.frame_id}, no building of this map)"
    there = truth.frame_id if truth.frame_id != matches.matches[0].map else ""
    truly = f"truly {there}{' ' if there else ''}{_at(truth.position)}"
    return f"  {'WRONG' if matches.status == 'match' else 'wrong'}: {truly}"


def _line(answer: Answer, seconds: float) -> _Line:
    from semloc_core.explain import LAYOUT

    matches, why = answer.matches, ""
    if matches.status != "unknown":
        if answer.evidence is not None:
            why = f"  because {_most(answer.evidence)}"
        if answer.attributions is not None and answer.attributions.method != LAYOUT:
            why += f"  {answer.attributions.method}: {_most(answer.attributions)}"
    if not matches.matches:
        reason = answer.located.query.reason if answer.located is not None else ""
        return _Line(matches, f"{seconds:7.1f} s  {matches.status}{f'    {reason}' if reason else ''}", "")
    best = matches.matches[0]
    said = f"{best.map} {_at(best.position)} p={best.probability:.2f} s={best.similarity:.3f}"
    return _Line(matches, f"{seconds:7.1f} s  {matches.status:9s}  {said}", why)


def _at(position: Position) -> str:
    return "({:.1f}, {:.1f}, {:.1f})".format(*position)


def _most(said: ClassAttributions) -> str:
    named = [of for of in said.classes[:4] if of.share >= 0.005]
    return ", ".join(f"{of.class_} {percent(math.copysign(of.share, of.score))}" for of in named)
