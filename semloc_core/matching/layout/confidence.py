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
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.verifier import Verified
from semloc_core.text import short_repr

FEATURES = (
    "margin",
    "fraction",
    "share",
    "objects",
    "walls",
    "explained",
    "missing",
    "places",
    "score",
)
SHARPNESS = 0.5
"""Exponent on the likelihoods that share belief among places: objects are not independent."""
OTHERS = ("share", "left", "left_in_map", "fraction", "objects")
NEAR = ("metres", "objects", "metres_objects")
MOST_SURE = 0.999
"""P(the robot is in the map) counts as no more where belief is shared: two places that fit alike are no match."""
_SHARINGS = 8
_NO_CHANCE = 1e-9
LIKELY = 0.01
"""An answer that is so much less likely than the best one is taken to be on the storey of the place it was found by."""
AS_LIKELY = 0.98
"""Between floors, P(on another storey) over P(on the one that is named first)."""
CLIP = 3.0
"""Features count up to so many standard deviations from the mean: beyond, nothing was learnt."""


@short_repr
@dataclass(frozen=True, eq=False)
class Confidence:
    """What may be believed of a verified answer.

    Args:
        probability: (T,) P(the robot is within the match radius of the place and on its storey), for each place tested
            on its own.
        in_map: P(the robot is in the map).
        order: (T,) in which to list the places: by falling probability.
        answers: what the probability of any place of the map follows from.
        off: (T,) metres of each place tested from where it best fits in.

    """

    probability: Floats
    in_map: float
    order: Ints
    answers: Answers
    off: Floats

    @classmethod
    def of(cls, answers: Answers, in_map: float, off: Floats, mapped: MappedLayout, rows: Ints) -> Confidence:
        """What follows from answers for the (T,) rows of the map that were tested."""
        probability = answers.probability(mapped, rows)
        order = np.lexsort((np.arange(len(probability)), off, -probability))
        return cls(probability, in_map, order, answers, off)

    def weighed(self, by: Floats, mapped: MappedLayout, rows: Ints) -> Confidence:
        """The same, each answer (A,) times as likely."""
        in_map = max(self.in_map, float((self.answers.likely() * by).sum()))
        return Confidence.of(self.answers.weighed(by), in_map, self.off, mapped, rows)


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fitted regressions, as kept in ``calibration.json``.

    Args:
        mean: (F,) of the features.
        deviation: (F,) standard deviations.
        right: weights of ``terms`` for the best answer being right.
        in_map: the same for the robot being in the map.
        others: weights of one and of the figures `OTHERS`, for another answer being right.
        near: weights of one and of the figures `NEAR`, for a place being right where an answer near it is.

    """

    features: tuple[str, ...]
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    right: tuple[float, ...]
    in_map: tuple[float, ...]
    others: tuple[float, ...]
    near: tuple[float, ...]

    def terms(self, x: Floats) -> Floats:
        """(N, 1 + F + F (F + 1) / 2) one, the standardised features (N, F), their squares and products."""
        z = np.clip((x - np.array(self.mean)) / np.array(self.deviation), -CLIP, CLIP)
        i, j = _products(z.shape[1])
        found: Floats = np.concatenate([np.ones((len(z), 1)), z, z[:, i] * z[:, j]], axis=1)
        return found


@lru_cache(maxsize=1)
def shipped_calibration() -> Calibration:
    """The calibration that is part of the package."""
    data = files("semloc_core.matching.layout").joinpath("calibration.json").read_bytes()
    found = msgspec.json.decode(data, type=Calibration)
    assert found.features == FEATURES, found.features
    return found


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
    chance = chance / max(float(_near(calibration, off, n)[0]), 0.5)
    if robot is not None:
        poses = poses + _turned(robot - fragment.origin, verified.heading[found.separate])
    answers = _by_storey(mapped, verified, found.separate, poses, chance, right, n, calibration)
    return Confidence.of(answers, in_map, found.off, mapped, verified.rows)


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
    on = [
        mapped.storeys_at(pose, row) if p >= LIKELY * chance[0] else [int(mapped.storey[row])]
        for pose, row, p in zip(poses, rows.tolist(), chance.tolist(), strict=True)
    ]
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


@short_repr
@dataclass(frozen=True, eq=False)
class Answers:
    """Where the robot may be.

    Args:
        pose: (A, 3) metres, best first.
        heading: (A,) radians: the robot's frame turned by it is parallel to the building's.
        building: (A,) of the map.
        storey: (A,) of the map.
        chance: (A,) of each, by which what is near it counts.
        most: the probability of the best place; no other is believed more.
        n_objects: seen.
        calibration: says how far from there places are right.

    """

    pose: Floats
    heading: Floats
    building: Ints
    storey: Ints
    chance: Floats
    most: float
    n_objects: int
    calibration: Calibration

    def likely(self) -> Floats:
        """(A,) P(right) of each: that the place nearest to it is; they sum to 1 at most, as in `probability`."""
        if self.chance[0] <= 0:
            return np.zeros(len(self.chance))
        chance: Floats = self.chance * (self.most / self.chance[0])
        rest = float(chance[1:].sum())
        if chance[0] + rest > 1.0:
            chance[1:] *= (1.0 - chance[0]) / rest
        return chance

    def weighed(self, by: Floats) -> Answers:
        """The same, each (A,) times as likely."""
        chance = self.chance * by
        order = np.argsort(-chance, kind="stable")
        return Answers(
            pose=self.pose[order],
            heading=self.heading[order],
            building=self.building[order],
            storey=self.storey[order],
            chance=chance[order],
            most=min(1.0, self.most * float(chance.max() / self.chance[0])) if self.chance[0] > 0 else self.most,
            n_objects=self.n_objects,
            calibration=self.calibration,
        )

    def on_each_storey(self, mapped: MappedLayout) -> list[int]:
        """Rows of the map: where the best answer may be on several storeys, the nearest on each of them."""
        same = (self.pose == self.pose[0]).all(axis=1)
        found = []
        for storey in self.storey[same].tolist() if same.sum() > 1 else []:
            rows = np.flatnonzero(mapped.storey == storey)
            found.append(int(rows[np.linalg.norm(mapped.positions[rows] - self.pose[0], axis=1).argmin()]))
        return found

    def probability(self, mapped: MappedLayout, rows: Ints) -> Floats:
        """(K,) P(right) of (K,) rows of the map, tested or not, each for itself; none more than the best answer's.

        Places too far apart to be right together, of these rows, share one at most.
        """
        away = np.linalg.norm(mapped.positions[rows][:, None] - self.pose, axis=2)
        near = _near(self.calibration, away, self.n_objects)
        near = np.where(mapped.storey[rows][:, None] == self.storey, near, 0.0)
        total: Floats = (near * self.chance).sum(axis=1)
        np.minimum(total, self.most, out=total)
        return np.round(_shared(total, mapped.positions[rows], mapped.building[rows]), 9)


def _shared(chance: Floats, at: Floats, building: Ints) -> Floats:
    """(K,) chances of places, those beyond reach of the likeliest lowered until what can't be together is at most 1.

    Two places further apart than twice the match radius, or in two buildings, can't both be right.

    Args:
        chance: (K,) of each place.
        at: (K, 3) metres.
        building: (K,) of each.

    """
    for _ in range(_SHARINGS):
        order = np.argsort(-chance, kind="stable")
        order = order[chance[order] > _NO_CHANCE]
        total, left, elsewhere = 0.0, order, order
        while len(left):
            first = left[0]
            apart = np.linalg.norm(at[left] - at[first], axis=1) > 2 * MATCH_RADIUS_M
            apart |= building[left] != building[first]
            if not total:
                elsewhere = left[apart]
            total, left = total + float(chance[first]), left[apart]
        if total <= 1.0:
            break
        best = float(chance[order[0]])
        chance = chance.copy()
        chance[elsewhere] *= (1.0 - best) / (total - best)
    return chance


def _near(calibration: Calibration, metres: Floats, n_objects: int) -> Floats:
    """P(a place is right) so far from where an answer that is right has the robot."""
    x = near_figures(metres, n_objects) @ np.array(calibration.near)
    chance: Floats = 1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0)))
    return chance


def near_figures(metres: Floats, n_objects: int) -> Floats:
    """(…, 1 + len(NEAR)) one, and the figures of `NEAR`."""
    n = np.full(metres.shape, math.log(max(n_objects, 1)))
    return np.stack([np.ones(metres.shape), metres, n, metres * n], axis=-1)


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
        odds = odds * mapped.weights(fragment.likely)[np.arange(len(odds)), fragment.classes]
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


@lru_cache(maxsize=1)
def _products(n: int) -> tuple[Ints, Ints]:
    i, j = np.triu_indices(n)
    return i, j


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x)) if x > -700 else 0.0
