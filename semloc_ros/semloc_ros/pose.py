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

from semloc_core.wire import PlaceMatches


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
