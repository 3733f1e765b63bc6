# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""When the transform from a building's frame to that of the updates is sent, as REP-105 has it. No ROS here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from semloc_core.wire import MapInfo, PlaceMatches, Transform

PERIOD_S = 0.1
"""How often the latest transform is sent again."""
LOST_NS = 3_000_000_000
"""For so long ``unknown`` or ``no_graph`` may be the answer before nothing is sent."""
JUMP_NS = 5_000_000_000
"""A clock that gains so much has jumped. One that is simulated goes faster than the world's, but in small steps."""
BACK_NS = 100_000_000
"""A clock that loses so much has jumped; a clock that is set right by a little goes back by less."""


@dataclass(frozen=True)
class Stamped:
    """A transform to be sent.

    Args:
        stamp_ns: until when it holds.
        parent: the building's frame.
        child: the frame that updates name.
        transform: takes positions in ``child`` to those in ``parent``.

    """

    stamp_ns: int
    parent: str
    child: str
    transform: Transform


@dataclass(frozen=True)
class _Held:
    parent: str
    child: str
    building: str
    map: MapInfo | None
    transform: Transform


class Steady:
    """Holds the latest transform and says when to send it. Any thread may use it.

    Args:
        refused: called with one line for a pair of frames that can't be joined, once.

    """

    def __init__(self, refused: Callable[[str], None]) -> None:
        self._refused = refused
        self._lock = threading.Lock()
        self._held: _Held | None = None
        self._lost_ns: int | None = None
        self._clock: tuple[int, int] | None = None
        self._update_ns: int | None = None
        self._sent_ns: int | None = None
        self._said: set[tuple[str, str]] = set()

    def forget(self) -> None:
        """Send nothing until the next match: the graph, the map or the frames are others."""
        with self._lock:
            self._forget()

    def answer(
        self, matches: PlaceMatches, child: str, now_ns: int, steady_ns: int, tolerance_s: float
    ) -> Stamped | None:
        """Take an answer in.

        Args:
            matches: the answer.
            child: the frame of the update that it answers.
            now_ns: by the node's clock, which may be simulated; 0 where that does not run yet.
            steady_ns: by a clock that never jumps.
            tolerance_s: how far ahead a transform holds, seconds.

        Returns:
            What is to be sent.

        """
        with self._lock:
            self._watch(now_ns, steady_ns)
            if self._update_ns is not None and matches.stamp_ns < self._update_ns:
                self._forget()  # the run begins again, with a frame of its own
            self._update_ns = matches.stamp_ns
            held = self._held
            if held is not None and (held.child, held.map) != (child, matches.map) and matches.status != "no_graph":
                self._forget()
            if matches.status == "match":
                self._take(matches, child)
            if matches.status in ("match", "ambiguous"):
                self._lost_ns = None
            elif self._lost_ns is None:
                self._lost_ns = self._base_ns(now_ns)
            return self._due(now_ns, tolerance_s)

    def tick(self, now_ns: int, steady_ns: int, tolerance_s: float) -> Stamped | None:
        """Say what is to be sent between answers; arguments as of `answer`."""
        with self._lock:
            self._watch(now_ns, steady_ns)
            return self._due(now_ns, tolerance_s)

    def _take(self, matches: PlaceMatches, child: str) -> None:
        best, parent = matches.matches[0], matches.frame_id
        if matches.transform is not None:
            line = _joined(parent, child)
            self._held = None if line else _Held(parent, child, best.map, matches.map, matches.transform)
            if line and (parent, child) not in self._said:
                self._said.add((parent, child))
                self._refused(line)
        elif self._held is not None and (self._held.building, self._held.parent) != (best.map, parent):
            self._forget()

    def _due(self, now_ns: int, tolerance_s: float) -> Stamped | None:
        base_ns = self._base_ns(now_ns)
        if self._lost_ns is not None and base_ns - self._lost_ns >= LOST_NS:
            self._forget()
        held, stamp_ns = self._held, base_ns + round(tolerance_s * 1e9)
        # Where the clock stands still what holds until then has been said.
        if held is None or (self._sent_ns is not None and stamp_ns <= self._sent_ns):
            return None
        self._sent_ns = stamp_ns
        return Stamped(stamp_ns, held.parent, held.child, held.transform)

    def _base_ns(self, now_ns: int) -> int:
        """By the node's clock; by the updates', where these are ahead of it or it does not run."""
        return now_ns if self._update_ns is None else max(now_ns, self._update_ns)

    def _watch(self, now_ns: int, steady_ns: int) -> None:
        before, self._clock = self._clock, (now_ns, steady_ns)
        if before is None or not before[0]:  # a clock that begins to run has not jumped
            return
        gained_ns = now_ns - before[0]
        if gained_ns < -BACK_NS or gained_ns > JUMP_NS + steady_ns - before[1]:
            self._forget()
            self._update_ns = None

    def _forget(self) -> None:
        self._held = self._lost_ns = self._sent_ns = None


def _joined(parent: str, child: str) -> str:
    """Why no transform can join two frames; empty where one can."""
    if not child.strip("/"):
        return "no transform is sent: expected the updates to name their frame (got an empty frame_id)"
    if parent.strip("/") == child.strip("/"):
        return (
            f"no transform is sent: expected the updates' frame to be another than the building's (got {child!r} for "
            "both): give parameter frame_id another value, or the updates a frame of their own such as odom"
        )
    return ""
