"""How sure one can be of a verified answer: P(the best place is within 4 m), and P(the robot is in the map at all).

The log-likelihood ratios of the places tested assume more than is true (objects come in groups, buildings resemble one
another), so they are not taken at their word: a logistic regression on a few figures of the whole answer, and their
squares and products, says what answers like this one were worth on generated buildings, at home and abroad
(`semloc_core.evaluate.fit_confidence`).
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
CLIP = 3.0
"""Features count up to so many standard deviations from the mean: beyond, nothing was learnt."""


@dataclass(frozen=True, eq=False)
class Confidence:
    """What may be believed of a verified answer.

    Args:
        probability: (T,) P(the robot is within the match radius of the place), for each place tested on its own.
        in_map: P(the robot is in the map).
        order: (T,) in which to list the places: by falling probability; those of one answer, which are equally
            likely, by their distance in the plane from where the robot fits in best.

    """

    probability: Floats
    in_map: float
    order: Ints


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A fitted regression, as kept in ``calibration.json``.

    Args:
        mean: (F,) of the features.
        deviation: (F,) standard deviations.
        right: weights of ``terms`` for the best place being right.
        in_map: the same for the robot being in the map.

    """

    features: tuple[str, ...]
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    right: tuple[float, ...]
    in_map: tuple[float, ...]

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
    verified: Verified, fragment: Fragment, mapped: MappedLayout, calibration: Calibration | None = None
) -> Confidence:
    """Believe a verified answer as far as experience goes.

    Args:
        verified: the answer.
        fragment: what it was given for.
        mapped: the map.
        calibration: None for the shipped one.

    """
    calibration = calibration or shipped_calibration()
    answers = _Answers.of(verified, mapped)
    mass = answers.masses(SHARPNESS)
    terms = calibration.terms(_features(verified, fragment, mapped, answers.together[0], float(mass[0]))[None])[0]
    # Whatever was learnt: of two places that fit equally well neither is likelier than the other.
    share = answers.masses(1.0)
    learnt = _logistic(float(terms @ np.array(calibration.right)))
    in_map = max(learnt, _logistic(float(terms @ np.array(calibration.in_map))))
    right = min(learnt, float(share[0]))
    # No place is believed more than the best one; and all answers elsewhere share what the best one leaves.
    chance, elsewhere = right * mass / mass[0], ~answers.together[0]
    others = share[elsewhere] / max(1.0 - float(share[0]), np.finfo(np.float64).tiny)
    chance[elsewhere] = np.minimum(chance[elsewhere], max(in_map - right, 0.0) * np.minimum(others, 1.0))
    chance = np.round(np.minimum(chance, right), 9)
    at = mapped.positions[verified.rows, :2]
    off = np.linalg.norm(at - (at[0] + verified.shift[0]), axis=1)
    return Confidence(chance, in_map, np.lexsort((np.arange(len(chance)), off, -chance)))


def features(verified: Verified, fragment: Fragment, mapped: MappedLayout) -> Floats:
    """(F,) the figures of `FEATURES`."""
    answers = _Answers.of(verified, mapped)
    return _features(verified, fragment, mapped, answers.together[0], float(answers.masses(SHARPNESS)[0]))


def _features(
    verified: Verified, fragment: Fragment, mapped: MappedLayout, together: NDArray[np.bool_], share: float
) -> Floats:
    n, best = len(fragment.classes), 0
    config = mapped.config
    perfect = np.log1p(config.detected / (2 * np.pi * config.spread_m**2) / mapped.invented[fragment.classes]).sum()
    elsewhere = ~together
    rival = verified.score[elsewhere].max() if elsewhere.any() else verified.score.min() - 5.0
    score = float(verified.score[best])
    return np.array(
        [
            math.log1p(min(max(score - float(rival), 0.0), 20.0)),
            score / float(perfect),
            math.log(share / (1 - share + 1e-6)),
            math.log(n),
            float(verified.walls[best]) / max(len(fragment.places), 1),
            float((verified.explained[best] > 1.0).mean()),
            float(verified.missing[best]) / n,
            math.log(len(fragment.places) + 1),
            math.log1p(max(score, 0.0)),
        ]
    )


def masses(verified: Verified, mapped: MappedLayout, sharpness: float = SHARPNESS) -> Floats:
    """(T,) share in the belief of the best place within the match radius of each place tested, in (0, 1].

    Belief is shared among answers, not among places: how many places of one answer were tested says nothing.
    """
    return _Answers.of(verified, mapped).masses(sharpness)


@dataclass(frozen=True, eq=False)
class _Answers:
    """Which of T places tested, best first, are one answer.

    Args:
        score: (T,) of the places.
        together: (T, T) whether two are within the match radius.
        separate: the best place of each answer.

    """

    score: Floats
    together: NDArray[np.bool_]
    separate: list[int]

    @classmethod
    def of(cls, verified: Verified, mapped: MappedLayout) -> _Answers:
        at, of = mapped.positions[verified.rows], mapped.building[verified.rows]
        x, y, z = (np.subtract.outer(axis, axis) for axis in at.T)
        together = (np.sqrt(x * x + y * y + z * z) <= MATCH_RADIUS_M) & np.equal.outer(of, of)
        separate: list[int] = []
        taken = np.zeros(len(at), dtype=np.bool_)
        for place in range(len(at)):
            if not taken[place]:
                separate.append(place)
                taken |= together[place]
        return cls(verified.score, together, separate)

    def masses(self, sharpness: float) -> Floats:
        """(T,) as of `masses`."""
        weight = np.exp(sharpness * (self.score - self.score[0]))
        found: Floats = np.where(self.together, weight, 0.0).max(axis=1) / weight[self.separate].sum()
        return found


@lru_cache(maxsize=1)
def _products(n: int) -> tuple[Ints, Ints]:
    i, j = np.triu_indices(n)
    return i, j


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-x)) if x > -700 else 0.0
