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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.wire import PlaceMatches, Position

PLACE_STD_M = 0.5
"""A place stands for the free space around it: no match says more than this, per axis."""
YAW_VARIANCE = math.pi**2 / 3
"""Of a heading that can't be observed: uniform over a full turn, rad²."""
TILT_VARIANCE = 1e-4
"""Roll and pitch of a robot on a level floor, rad²; not zero, so that the matrix can be inverted."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the robot is.

    Args:
        position: metres, in the matched building's frame.
        covariance: (6, 6) float64 over x, y, z (m²), roll, pitch, yaw (rad²).

    """

    position: Position
    covariance: NDArray[np.float64]


def pose_of(answer: PlaceMatches) -> Pose | None:
    """The pose that an answer gives; None unless its status is ``match``.

    The position is the best match's. Its covariance is the second moment, about this position, of the matches in
    the same building, each weighted by its probability, plus what a place itself leaves open.
    """
    if answer.status != "match" or not answer.matches:
        return None
    best = answer.matches[0]
    near = [match for match in answer.matches if match.map == best.map]
    weights = np.array([match.probability for match in near])
    offsets = np.array([match.position for match in near]) - np.array(best.position)
    covariance = np.diag([PLACE_STD_M**2] * 3 + [TILT_VARIANCE, TILT_VARIANCE, YAW_VARIANCE])
    if weights.sum() > 0:
        covariance[:3, :3] += np.einsum("n,ni,nj->ij", weights / weights.sum(), offsets, offsets)
    return Pose(best.position, covariance)


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
