"""What a traversal says of each object of the map: still there, elsewhere, gone, or nothing.

A Bayes filter over "the object is where the map has it" (Rosen, Mason and Leonard, "Towards lifelong feature-based
mapping in semi-static environments", ICRA 2016): between two traversals an object stays with 1 - λ of its class (their
survival prior, here geometric), a detector misses what is there, and now and then sees what is not. λ is not given but
learnt with it: the chance that each object moved is counted for its class (expectation maximisation), on top of what
earlier traversals counted.

That filter takes misses for independent. A detector's are not: what it overlooked once it is apt to overlook again.
So every object has a miss rate of its own, Beta distributed about the detector's; its misses and sightings update it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.map_database import ClassChange, ObjectBelief, move_rates
from semloc_core.map_merge.align import VERTICAL_GATE_M
from semloc_core.map_merge.config import MergeConfig
from semloc_core.text import short_repr

ROUNDS = 40
MISS_COUNTS = 200.0
"""How many objects the prior of the detector's miss rate weighs as much as."""

OBJECT_COUNTS = 2.0
"""How many looks at an object the detector's miss rate weighs as much as, in the object's own."""
OUT_OF_SIGHT = 0.5
"""Chance that an object which moved is not seen where it is now: missed, carried far, or not come by."""

Bools = NDArray[np.bool_]


@short_repr
@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of the map's O objects.

    Args:
        persistence: (O,) probability that each is where the map has it, now.
        expected: (O,) whether this traversal could tell.
        moved_to: (O,) the traversal's object that it is now, -1 where it did not move as far as can be told.
        changes: how many of each class stayed and moved, by this traversal alone.
        miss_rate: share of what was there that the traversal's detector missed.

    """

    persistence: Floats
    expected: Bools
    moved_to: Ints
    changes: dict[str, ClassChange]
    miss_rate: float


@short_repr
@dataclass(frozen=True, eq=False)
class Observation:
    """The map's O objects beside what a traversal saw.

    Args:
        classes: class name of each.
        beliefs: what was believed of each before.
        confirmed: (O,) seen where it was.
        expected: (O,) seen, or the free space around it was.
        positions: (O, 3) metres.
        spare: (S, 3) positions of the traversal's objects that are none of the confirmed.
        spare_classes: class name of each.
        area: m² that traversal and map both saw.

    """

    classes: Sequence[str]
    beliefs: Sequence[ObjectBelief]
    confirmed: Bools
    expected: Bools
    positions: Floats
    spare: Floats
    spare_classes: Sequence[str]
    area: float


def judge(
    seen: Observation, earlier: Sequence[Mapping[str, ClassChange]], config: MergeConfig, gate_m: float
) -> Verdict:
    """Update the belief in every object.

    Args:
        seen: what was seen.
        earlier: class changes counted before, of all buildings of the map.
        config: options.
        gate_m: within which an object was taken for the same.

    """
    before = np.array([belief.persistence for belief in seen.beliefs])
    looks = np.array([belief.expected for belief in seen.beliefs], dtype=np.float64)
    overlooked = looks - np.array([belief.seen for belief in seen.beliefs])
    names = sorted(set(seen.classes))
    number = {name: i for i, name in enumerate(names)}
    of_class = np.array([number[name] for name in seen.classes], dtype=np.int64)
    missing = seen.expected & ~seen.confirmed
    candidate, nearby = _candidates(seen, missing, config)
    in_class = np.bincount(of_class, minlength=len(names))
    strangers = config.new_rate * np.maximum(in_class, 1) / max(seen.area, 1.0)  # unrelated ones, a m²
    usual = config.miss_rate
    changes: dict[str, ClassChange] = {}
    stayed, moved, there = np.zeros(len(before)), np.zeros(len(before)), before.copy()
    for _ in range(ROUNDS):
        rates = move_rates([*earlier, changes], names)
        rate = np.array([rates[name] for name in names])[of_class]
        stranger = strangers[of_class]
        miss = (OBJECT_COUNTS * usual + overlooked) / (OBJECT_COUNTS + looks)
        # Three stories of an object: still there, moved since, never there (or gone unnoticed before).
        still, gone, never = before * (1 - rate), before * rate, 1 - before
        by_chance = np.minimum(1.0, stranger * math.pi * gate_m**2)
        # Seen at its place: it is there, or a stranger of its class is.
        seen_there = (1 - miss) * still
        seen_gone, seen_never = by_chance * gone, by_chance * never
        # Not seen: missed, or not there; and the nearest stranger is it, or a stranger.
        found = OUT_OF_SIGHT + (1 - OUT_OF_SIGHT) * nearby / stranger
        unseen_there, unseen_gone, unseen_never = miss * still, found * gone, never
        a = np.where(seen.confirmed, seen_there, unseen_there)
        b = np.where(seen.confirmed, seen_gone, unseen_gone)
        total = a + b + np.where(seen.confirmed, seen_never, unseen_never)
        stayed = np.where(seen.expected, a / total, 0.0)
        moved = np.where(seen.expected, b / total, 0.0)
        there = np.where(seen.expected, a / total, before)
        present = stayed.sum() + MISS_COUNTS
        usual = float((stayed[missing].sum() + MISS_COUNTS * config.miss_rate) / present)
        changes = {
            name: ClassChange(float(stayed[of_class == i].sum()), float(moved[of_class == i].sum()))
            for i, name in enumerate(names)
        }
    moved_to = np.where(missing & (moved > 0.5), candidate, -1)
    return Verdict(there, seen.expected, moved_to, changes, usual)


def _candidates(seen: Observation, missing: Bools, config: MergeConfig) -> tuple[Ints, Floats]:
    """Where each missing object may be now: (O,) a spare object or -1, and (O,) density of its move there, 1/m²."""
    from scipy.optimize import linear_sum_assignment

    candidate = np.full(len(seen.classes), -1, dtype=np.int64)
    density = np.zeros(len(seen.classes))
    spread = 2 * config.moved_m**2
    lost = np.flatnonzero(missing).tolist()
    for name in sorted({seen.classes[i] for i in lost} & set(seen.spare_classes)):
        ours = np.array([i for i in lost if seen.classes[i] == name])
        theirs = np.array([i for i, other in enumerate(seen.spare_classes) if other == name])
        apart = seen.positions[ours][:, None] - seen.spare[theirs]
        squared = apart[..., 0] ** 2 + apart[..., 1] ** 2
        squared[np.abs(apart[..., 2]) > VERTICAL_GATE_M] = 1e6
        a, b = linear_sum_assignment(np.minimum(squared, 9 * spread))
        kept = squared[a, b] < 9 * spread / 2  # three standard deviations
        candidate[ours[a[kept]]] = theirs[b[kept]]
        density[ours[a[kept]]] = np.exp(-squared[a, b][kept] / spread) / (math.pi * spread)
    return candidate, density
