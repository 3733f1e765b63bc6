"""How sure one can be of a verified answer: P(right) of each place, and P(the robot is in the map at all).

Right is a place within 4 m of the robot and on its storey. The places tested are a few answers: one is all that lies
within 4 m, on one storey, of a place that fits better. Each says where the robot would be: where it fits in best, in
three dimensions. How likely an answer is, `Calibration.right` and `Calibration.others` say; how likely a place is
then, `Calibration.near`, by how far it lies from there. The log-likelihood
ratios of the places tested assume more than is true (objects come in groups, buildings resemble one another), so they
are not taken at their word: logistic regressions on a few figures say what answers like these were worth on generated
buildings, at home and abroad (`semloc_core.evaluate.fit_confidence`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.answers import Answers, Calibration, near_chance, shipped_calibration
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.verifier import Verified
from semloc_core.text import short_repr

SHARPNESS = 0.5
"""Exponent on the likelihoods that share belief among places: objects are not independent."""
OTHERS = ("share", "left", "left_in_map", "fraction", "objects")
MOST_SURE = 0.999
"""P(the robot is in the map) counts as no more where belief is shared: two places that fit alike are no match."""
LIKELY = 0.01
"""An answer that is so much less likely than the best one is taken to be on the storey of the place it was found by."""
AS_LIKELY = 0.98
"""Between floors, P(on another storey) over P(on the one that is named first)."""


@short_repr
@dataclass(frozen=True, eq=False)
class Confidence:
    """What may be believed of a verified answer.

    Args:
        answers: what the probability of any place of the map follows from.
        in_map: P(the robot is in the map).
        off: (T,) metres of each place tested from where it best fits in.
        mapped: the map.
        rows: (T,) the places tested.

    """

    answers: Answers
    in_map: float
    off: Floats
    mapped: MappedLayout
    rows: Ints

    @cached_property
    def probability(self) -> Floats:
        """(T,) P(the robot is within the match radius of the place and on its storey), for each on its own."""
        return self.answers.probability(self.mapped, self.rows)

    @property
    def order(self) -> Ints:
        """(T,) in which to list the places: by falling probability."""
        found: Ints = np.lexsort((np.arange(len(self.off)), self.off, -self.probability))
        return found

    def listed(self, rest: Ints) -> tuple[Ints, Floats]:
        """Rows of the map, those tested and some (R,) more, by falling probability, and (T + R,) these."""
        rows = np.concatenate([self.rows, rest])
        chance = self.answers.probability(self.mapped, rows)
        off = np.concatenate([self.off, np.full(len(rest), np.inf)])
        order = np.lexsort((np.arange(len(rows)), off, -chance))
        return rows[order], chance[order]

    def weighed(self, by: Floats) -> Confidence:
        """The same, each answer (A,) times as likely."""
        in_map = max(self.in_map, float((self.answers.likely() * by).sum()))
        return replace(self, answers=self.answers.weighed(by), in_map=in_map)


def confidence(
    verified: Verified,
    fragment: Fragment,
    mapped: MappedLayout,
    calibration: Calibration | None = None,
    robot: Floats | None = None,
) -> Confidence:
    """Believe a verified answer as far as experience goes.

    Args:
        verified: the answer.
        fragment: what it was given for.
        mapped: the map.
        calibration: None for the shipped one.
        robot: (3,) metres, where the robot is in its frame; None: at the place that the fragment is around.

    """
    calibration = calibration or shipped_calibration()
    found = Tested.of(verified, mapped)
    terms = calibration.terms(_features(verified, fragment, mapped, found)[None])[0]
    learnt = _logistic(float(terms @ np.array(calibration.right)))
    in_map = max(learnt, _logistic(float(terms @ np.array(calibration.in_map))))
    # Whatever was learnt: of two answers that fit equally well neither is likelier than the other.
    share = found.masses(1.0)[found.separate]
    right = min(learnt, float(share[0]) * min(in_map, MOST_SURE))
    chance: Floats = np.ones(len(share))
    chance *= right
    if len(share) > 1:
        x = other_figures(
            found.score[found.separate[1:]], right, in_map, perfect(fragment, mapped), len(fragment.classes)
        )
        chance[1:] = 1.0 / (1.0 + np.exp(-np.clip(x @ np.array(calibration.others), -50.0, 50.0)))
        # Likelihoods exaggerate: another answer is at least as likely as they say, but never likelier than the best.
        chance[1:] = np.clip(chance[1:], right * np.exp(found.score[found.separate[1:]] - found.score[0]), right)
    poses, n = found.pose[found.separate], len(fragment.classes)
    # What the best answer's chance was fitted for is its nearest place.
    nearest = verified.rows[found.nearest(0, mapped, verified.rows)]
    off = np.linalg.norm(mapped.positions[[nearest]] - poses[0], axis=1)
    chance = chance / max(float(near_chance(calibration, off, n)[0]), 0.5)
    if robot is not None:
        poses = poses + _turned(robot - fragment.origin, verified.heading[found.separate])
    answers = _by_storey(mapped, verified, found.separate, poses, chance, right, n, calibration)
    return Confidence(answers, in_map, found.off, mapped, verified.rows)


def _by_storey(
    mapped: MappedLayout,
    verified: Verified,
    separate: list[int],
    poses: Floats,
    chance: Floats,
    right: float,
    n_objects: int,
    calibration: Calibration,
) -> Answers:
    """Answers found by some places of a test, with these poses: each once for each storey that it may be on.

    An answer is on the storey where it has the robot, whatever place it was found by; between floors, where a robot on
    stairs is, it is nearly as likely on one as on another.
    """
    rows = verified.rows[separate]
    on = [[storey] for storey in mapped.storey[rows].tolist()]
    likely = np.flatnonzero(chance >= LIKELY * chance[0])
    for answer, storeys in zip(likely.tolist(), mapped.storeys_of(poses[likely], rows[likely]), strict=True):
        on[answer] = storeys
    times = np.array([len(each) for each in on])
    shares = [np.array([1.0, *[AS_LIKELY] * (n - 1)]) / (1.0 + AS_LIKELY * (n - 1)) for n in times.tolist()]
    return Answers(
        pose=np.repeat(poses, times, axis=0),
        heading=np.repeat(verified.heading[separate], times),
        building=np.repeat(mapped.building[rows], times),
        storey=np.array([storey for each in on for storey in each], dtype=np.int64),
        chance=np.repeat(chance, times) * np.concatenate(shares),
        most=right if times[0] == 1 else min(right, MOST_SURE) / int(times[0]),
        n_objects=n_objects,
        calibration=calibration,
    )


def other_figures(score: Floats, right: float, in_map: float, best_score: float, n_objects: int) -> Floats:
    """(A, 1 + len(OTHERS)) one, and the figures of `OTHERS` of each answer but the best.

    Args:
        score: (A,) theirs.
        right: P(the best one is right).
        in_map: P(the robot is in the map).
        best_score: that there could be (`perfect`).
        n_objects: seen.

    """
    weight = np.exp(SHARPNESS * (score - score.max()))
    n = len(score)
    return np.stack(
        [
            np.ones(n),
            np.log(weight / weight.sum()),
            np.full(n, math.log(max(1.0 - right, 1e-4))),
            np.full(n, math.log(max(in_map - right, 1e-4))),
            score / best_score,
            np.full(n, math.log(n_objects)),
        ],
        axis=1,
    )


def features(verified: Verified, fragment: Fragment, mapped: MappedLayout) -> Floats:
    """(F,) the figures of `FEATURES`."""
    return _features(verified, fragment, mapped, Tested.of(verified, mapped))


def _features(verified: Verified, fragment: Fragment, mapped: MappedLayout, found: Tested) -> Floats:
    n, best = len(fragment.classes), 0
    elsewhere = ~found.together[0]
    rival = verified.score[elsewhere].max() if elsewhere.any() else verified.score.min() - 5.0
    score, share = float(verified.score[best]), float(found.masses(SHARPNESS)[0])
    return np.array(
        [
            math.log1p(min(max(score - float(rival), 0.0), 20.0)),
            score / perfect(fragment, mapped),
            math.log(share / (1 - share + 1e-6)),
            math.log(n),
            float(verified.walls[best]) / max(len(fragment.places), 1),
            float((verified.explained[best] > 1.0).mean()),
            float(verified.missing[best]) / n,
            math.log(len(fragment.places) + 1),
            math.log1p(max(score, 0.0)),
        ]
    )


def perfect(fragment: Fragment, mapped: MappedLayout) -> float:
    """The score of what is seen, were each object exactly where the map has it."""
    config = mapped.config
    odds = config.detected / (2 * np.pi * config.spread_m**2) / mapped.invented[fragment.classes]
    if fragment.likely is not None:
        weights = mapped.weights(fragment.likely)
        each = odds * weights[np.arange(len(odds)), fragment.classes]
        best = (weights / mapped.invented).max(axis=1) * config.detected / (2 * np.pi * config.spread_m**2)
        odds = np.where(fragment.classes >= 0, each, best)
    return float(np.log1p(odds).sum())


def masses(verified: Verified, mapped: MappedLayout, sharpness: float = SHARPNESS) -> Floats:
    """(T,) share in the belief of the best place within the match radius of each place tested, in (0, 1].

    Belief is shared among answers, not among places: how many places of one answer were tested says nothing.
    """
    return Tested.of(verified, mapped).masses(sharpness)


@short_repr
@dataclass(frozen=True, eq=False)
class Tested:
    """Which of T places tested, best first, are one answer.

    Args:
        score: (T,) of the places.
        pose: (T, 3) metres, where the robot fits in best, by each place.
        storey: (T,) of the places.
        together: (T, T) whether two are within the match radius and on one storey.
        separate: (A,) the best place of each answer.
        off: (T,) metres from where the best place has the robot.

    """

    score: Floats
    pose: Floats
    storey: Ints
    together: NDArray[np.bool_]
    separate: list[int]
    off: Floats

    @classmethod
    def of(cls, verified: Verified, mapped: MappedLayout) -> Tested:
        """Tell the answers of a test apart."""
        at, on = mapped.positions[verified.rows], mapped.storey[verified.rows].astype(np.int64)
        x, y, z = (np.subtract.outer(axis, axis) for axis in at.T)
        together = (np.sqrt(x * x + y * y + z * z) <= MATCH_RADIUS_M) & np.equal.outer(on, on)
        separate: list[int] = []
        taken = np.zeros(len(at), dtype=np.bool_)
        for place in range(len(at)):
            if not taken[place]:
                separate.append(place)
                taken |= together[place]
        pose = at + np.concatenate([verified.shift, verified.rise[:, None]], axis=1)
        return cls(verified.score, pose, on, together, separate, np.linalg.norm(at - pose[0], axis=1))

    def nearest(self, answer: int, mapped: MappedLayout, rows: Ints) -> int:
        """Of the places of an answer (a number of ``separate``), the nearest to where it has the robot."""
        own = np.flatnonzero(self.together[answer])
        away = np.linalg.norm(mapped.positions[rows[own]] - self.pose[answer], axis=1)
        return int(own[np.argmin(away)])

    def masses(self, sharpness: float) -> Floats:
        """(T,) as of `masses`."""
        weight = np.exp(sharpness * (self.score - self.score[0]))
        found: Floats = np.where(self.together, weight, 0.0).max(axis=1) / weight[self.separate].sum()
        return found


def _turned(offset: Floats, heading: Floats) -> Floats:
    """(A, 3) an offset (3,), metres, turned by (A,) headings, radians."""
    c, s = np.cos(heading), np.sin(heading)
    x, y, z = offset.tolist()
    return np.stack([c * x - s * y, s * x + c * y, np.full(len(heading), z)], axis=1)


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x)) if x > -700 else 0.0
