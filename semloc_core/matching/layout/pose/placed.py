"""Where the robot's frame lies in the map's buildings: a transform for each answer, and a pose made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.confidence import SHARPNESS
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.refine import Refined, refine
from semloc_core.matching.layout.verifier import Verified
from semloc_core.text import short_repr

SAME_M, SAME_RAD = 0.75, math.radians(20.0)
"""Aligned poses so near to one another are refined as one."""
RIVALLING = 10.0
"""Poses of the best answer that score worse than its best by more nats than this are not looked at again."""
MOST = 6
"""Poses that are refined for one update at most; bounds its cost."""
CHANCE = 10.0
"""Of the poses within the match radius, in all headings, chance makes one so likely, nats; fitted on generated homes.
About what their volume is over that of a pose known to 0.1 m and 6°."""
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
    """Refined transforms by row of the map, of those of some rows that were put to the test, or lie near one that was.

    All rows of one answer have the same one: the best of it. Where several poses of an answer explain what is seen, its
    covariance holds their spread, and that of all others as far as it may be chance.

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
    first_of: dict[int, int] = {}
    for i, row in enumerate(tried.rows.tolist()):
        first_of.setdefault(row, i)
    for row in [row for row in rows if row not in first_of]:
        # A place that was not tested itself is where the best pose near it is, if one is.
        near = (building == mapped.building[row]) & (mapped.storey[tried.rows] == mapped.storey[row])
        near &= _squared(at - mapped.positions[row]) <= MATCH_RADIUS_M**2
        if near.any():
            first_of[row] = int(near.argmax())
    wanted = {row: first_of[row] for row in rows if row in first_of}
    if not wanted:
        return {}
    first = next(iter(wanted.values()))
    rivals = (building == building[first]) & (_squared(at - at[first]) <= MATCH_RADIUS_M**2)
    rivals &= tried.score >= tried.score[first] - RIVALLING
    some = _different([*wanted.values(), *np.flatnonzero(rivals).tolist()], at, building, tried.heading)
    refined = refine(mapped, fragment, tried.rows[some], tried.heading[some], tried.shift[some])
    position = mapped.positions[tried.rows[some]] + refined.shift
    score = refined.score - tried.missing[some] - tried.walls[some]
    of = building[some]
    within = (_squared(position[:, None] - position) <= MATCH_RADIUS_M**2) & (of[:, None] == of)
    # Of each refined pose the best of its answer.
    best = np.where(within, score, -np.inf).argmax(axis=1)
    chosen = np.array(list(wanted.values()))
    off = np.where(building[chosen][:, None] == of, _squared(at[chosen][:, None] - position), np.inf)
    nearest = off.argmin(axis=1)
    there = off[np.arange(len(chosen)), nearest] <= MATCH_RADIUS_M**2  # others are of more answers than are refined
    answers: dict[int, Placed] = {}
    result: dict[int, Placed] = {}
    for row, pose, found in zip(wanted, nearest.tolist(), there.tolist(), strict=True):
        if found:
            chief = int(best[pose])
            if chief not in answers:
                answers[chief] = _answer(fragment, refined, position, score, int(of[pose]), within[pose], chief)
            result[row] = answers[chief]
    return result


def _answer(
    fragment: Fragment,
    refined: Refined,
    position: Floats,
    score: Floats,
    building: int,
    group: NDArray[np.bool_],
    best: int,
) -> Placed:
    """One answer of T refined poses.

    Args:
        fragment: what was tested.
        refined: the poses.
        position: (T, 3) of them, metres.
        score: (T,) how well they fit.
        building: of the answer.
        group: (T,) which are of it.
        best: of these.

    """
    weight = np.exp(np.where(group, SHARPNESS * (score - score[best]), -np.inf))
    weight /= weight.sum()
    apart = np.zeros((len(group), 4))
    apart[:, :3] = position - position[best]
    turned = refined.heading - refined.heading[best]
    apart[:, 3] = np.arctan2(np.sin(turned), np.cos(turned))
    covariance = (weight @ refined.covariance.reshape(-1, 16)).reshape(4, 4) + (apart.T * weight) @ apart
    # Few objects fit by chance too: then the robot is anywhere there, however well they fit.
    by_chance = 1.0 / (1.0 + math.exp(min(float(score[best]) - CHANCE, 50.0)))
    anywhere = np.diag([MATCH_RADIUS_M**2 / 4, MATCH_RADIUS_M**2 / 4, covariance[2, 2], NO_YAW])
    covariance += by_chance * (anywhere - covariance)
    return Placed(building, float(refined.heading[best]), fragment.origin, position[best], covariance)


def _squared(offsets: Floats) -> Floats:
    """Squared lengths of (…, 3) offsets, m²."""
    found: Floats = (offsets * offsets).sum(axis=-1)
    return found


def _different(poses: list[int], at: Floats, building: Ints, heading: Floats) -> Ints:
    """The first of some aligned poses, `MOST` at most, none like one before it."""
    some = np.array(list(dict.fromkeys(poses)))
    alike = np.cos(heading[some][:, None] - heading[some]) >= math.cos(SAME_RAD)
    alike &= (_squared(at[some][:, None] - at[some]) <= SAME_M**2) & (building[some][:, None] == building[some])
    chosen: list[int] = []
    left = np.ones(len(some), dtype=np.bool_)
    while left.any() and len(chosen) < MOST:
        chosen.append(int(left.argmax()))
        left &= ~alike[chosen[-1]]
    return some[chosen]
