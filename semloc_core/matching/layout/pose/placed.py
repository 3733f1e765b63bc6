"""Where the robot's frame lies in the map's buildings: a transform for each answer, and a pose made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.confidence import SHARPNESS
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.refine import refine
from semloc_core.matching.layout.verifier import Verified
from semloc_core.text import short_repr

SAME_M, SAME_RAD = 0.75, math.radians(20.0)
"""Aligned poses so near to one another are refined as one."""
RIVALLING = 10.0
"""Poses of the best answer that score worse than its best by more nats than this are not looked at again."""
MOST = 6
"""Poses that are refined for one update at most; bounds its cost."""
NO_YAW = math.pi**2 / 3
"""Variance of a heading of which nothing is known, rad²."""


@short_repr
@dataclass(frozen=True, eq=False)
class Placed:
    """The robot's frame in a building's.

    Args:
        building: number of the building.
        yaw: radians; the robot's frame turned by it is parallel to the building's.
        origin: (3,) a point in the robot's frame, metres.
        position: (3,) where it is in the building's, metres.
        covariance: (4, 4) of that position and the yaw, m² and rad².

    """

    building: int
    yaw: float
    origin: Floats
    position: Floats
    covariance: Floats

    @property
    def translation(self) -> Floats:
        """(3,) metres: where the origin of the robot's frame is in the building's."""
        return self.of(np.zeros(3))

    def of(self, point: Floats) -> Floats:
        """A point (3,) of the robot's frame in the building's, metres."""
        found: Floats = self.position + self._turned(point - self.origin)
        return found

    def covariance_at(self, point: Floats) -> Floats:
        """(4, 4) as ``covariance``, of another point (3,) of the robot's frame: what a turn is off by moves it too."""
        lever = np.eye(4)
        x, y, _ = self._turned(point - self.origin)
        lever[0, 3], lever[1, 3] = -y, x
        found: Floats = lever @ self.covariance @ lever.T
        return found

    def _turned(self, point: Floats) -> Floats:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1], point[2]])


def placed(mapped: MappedLayout, fragment: Fragment, verified: Verified, rows: Sequence[int]) -> Mapping[int, Placed]:
    """Refined transforms by row of the map, of those of some rows that were put to the test.

    All rows of one answer have the same one: the best of it. Where several poses of an answer explain what is seen, its
    covariance holds their spread.

    Args:
        mapped: the map.
        fragment: what was tested.
        verified: the test.
        rows: of the map, best first.

    """
    tried = verified.tried
    at = mapped.positions[tried.rows]
    at[:, :2] += tried.shift
    building = mapped.building[tried.rows]
    wanted: dict[int, int] = {}
    for row in dict.fromkeys(rows):
        found = np.flatnonzero(tried.rows == row)[:1]
        if len(found):
            wanted[row] = int(found[0])
    if not wanted:
        return {}
    first = next(iter(wanted.values()))
    rivals = (building == building[first]) & (((at - at[first]) ** 2).sum(axis=1) <= MATCH_RADIUS_M**2)
    rivals &= tried.score >= tried.score[first] - RIVALLING
    some = _different([*dict.fromkeys(wanted.values()), *np.flatnonzero(rivals).tolist()], at, building, tried.heading)
    refined = refine(mapped, fragment, tried.rows[some], tried.heading[some], tried.shift[some])
    position = mapped.positions[tried.rows[some]] + refined.shift
    score = refined.score - tried.missing[some] - tried.walls[some]
    of, within = building[some], np.linalg.norm(position[:, None] - position, axis=2) <= MATCH_RADIUS_M
    within &= of[:, None] == of
    answers: dict[int, Placed] = {}
    result: dict[int, Placed] = {}
    for row, i in wanted.items():
        off = np.where(of == building[i], np.linalg.norm(position - at[i], axis=1), np.inf)
        nearest = int(off.argmin())
        if off[nearest] > MATCH_RADIUS_M:  # more answers than are refined
            continue
        group = np.flatnonzero(within[nearest])
        best = int(group[score[group].argmax()])
        if best not in answers:
            weight = np.exp(SHARPNESS * (score[group] - score[best]))
            apart = np.zeros((len(group), 4))
            apart[:, :3] = position[group] - position[best]
            turned = refined.heading[group] - refined.heading[best]
            apart[:, 3] = np.arctan2(np.sin(turned), np.cos(turned))
            each = refined.covariance[group] + apart[:, :, None] * apart[:, None, :]
            covariance = np.einsum("k,kij->ij", weight / weight.sum(), each)
            answers[best] = Placed(
                int(of[best]), float(refined.heading[best]), fragment.origin, position[best], covariance
            )
        result[row] = answers[best]
    return result


def _different(poses: list[int], at: Floats, building: Ints, heading: Floats) -> Ints:
    """The first of some aligned poses, `MOST` at most, none like one before it."""
    left = np.array(list(dict.fromkeys(poses)))
    chosen: list[int] = []
    while len(left) and len(chosen) < MOST:
        chosen.append(int(left[0]))
        alike = np.cos(heading[left] - heading[left[0]]) >= math.cos(SAME_RAD)
        alike &= ((at[left] - at[left[0]]) ** 2).sum(axis=1) <= SAME_M**2
        left = left[~(alike & (building[left] == building[left[0]]))]
    return np.array(chosen, dtype=np.int64)
