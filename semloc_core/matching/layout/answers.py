"""Where the robot may be, and how likely any place of the map is by that: what was fitted, and what follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import msgspec
import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.map_layout import MappedLayout
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
NEAR = ("metres", "objects", "metres_objects")
_SHARINGS = 8
_NO_CHANCE = 1e-9
CLIP = 3.0
"""Features count up to so many standard deviations from the mean: beyond, nothing was learnt."""


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
        near = near_chance(self.calibration, away, self.n_objects)
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
    if compiled():
        from semloc_core.matching.layout.compiled.answers import shared

        return shared(chance, np.ascontiguousarray(at), building, 2 * MATCH_RADIUS_M, _SHARINGS, _NO_CHANCE)
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


def near_chance(calibration: Calibration, metres: Floats, n_objects: int) -> Floats:
    """P(a place is right) so far from where an answer that is right has the robot."""
    x = near_figures(metres, n_objects) @ np.array(calibration.near)
    chance: Floats = 1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0)))
    return chance


def near_figures(metres: Floats, n_objects: int) -> Floats:
    """(…, 1 + len(NEAR)) one, and the figures of `NEAR`."""
    n = np.full(metres.shape, math.log(max(n_objects, 1)))
    return np.stack([np.ones(metres.shape), metres, n, metres * n], axis=-1)


@lru_cache(maxsize=1)
def _products(n: int) -> tuple[Ints, Ints]:
    i, j = np.triu_indices(n)
    return i, j
