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
"""A pose out of matches: where the best one is, and how far the probable ones lie from it. No ROS here."""

from __future__ import annotations

import math

from semloc_core.wire import PlaceMatches, matched_pose


class Consistency:
    """Says how many matches in a row agree: same map, same building, no step longer than the matching radius.

    Args:
        radius_m: the matching radius, metres.

    """

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        self._last: PlaceMatches | None = None
        self._length = 0

    def add(self, answer: PlaceMatches) -> int:
        """Take an answer in.

        Returns:
            How many matches in a row agree, this one included; 0 where it is no match.

        """
        if answer.status != "match" or not answer.matches:
            self._last, self._length = None, 0
            return 0
        self._length = self._length + 1 if self._last is not None and self._agree(self._last, answer) else 1
        self._last = answer
        return self._length

    def _agree(self, last: PlaceMatches, answer: PlaceMatches) -> bool:
        before, best = last.matches[0], answer.matches[0]
        return (
            last.map == answer.map
            and before.map == best.map
            and math.dist(before.position, best.position) <= self._radius_m
        )


ANSWER_S = 2.0
"""AMCL, where there is one, is told again after so long without an answer."""


class Seeding:
    """Says when AMCL is to be told where the robot is: once matches agree, and until somebody has heard it.

    Args:
        radius_m: the matching radius, metres.

    """

    def __init__(self, radius_m: float) -> None:
        self._consistency = Consistency(radius_m)
        self._agreeing = 0
        self._told_s: float | None = None
        self._answered = False
        self._listeners = 0

    def add(self, answer: PlaceMatches) -> bool:
        """Take an answer in; whether its pose can be told: it is a match's, and has a heading."""
        self._agreeing = self._consistency.add(answer)
        if self._agreeing <= 1:  # lost meanwhile, or somewhere else
            self._told_s, self._answered = None, False
        pose = matched_pose(answer)
        return pose is not None and pose.yaw is not None

    def answered(self) -> None:
        """AMCL has said where it believes the robot to be."""
        self._answered = self._told_s is not None

    def due(self, after: int, listeners: int, amcl: bool, now_s: float) -> bool:
        """Whether it is to be told now.

        Args:
            after: so many matches have to agree; 0: never.
            listeners: how many listen.
            amcl: whether there is an AMCL that could answer.
            now_s: by a clock that never jumps.

        """
        came, self._listeners = listeners > self._listeners, listeners
        if not after or self._agreeing < after or self._answered:
            return False
        if self._told_s is not None and not came and not (amcl and now_s - self._told_s >= ANSWER_S):
            return False
        self._told_s = now_s
        return True
