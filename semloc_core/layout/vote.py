"""Which heading would make the objects around the robot lie as those around a place of the map do.

Every pair of a seen object and a mapped one of its class votes for the headings that bring one near the other
(a Hough transform over one angle).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.geodesic import ranges
from semloc_core.graph_arrays import Floats, Ints
from semloc_core.layout.fragment import Fragment
from semloc_core.layout.mapped import MappedLayout
from semloc_core.layout.room import Floats32

HEADINGS = 24
"""Headings that are tried, evenly around."""
STEP = 2 * np.pi / HEADINGS
BESIDE = 3
"""Steps to either side of the best heading of a pair that is far from the robot, that it votes for."""
SHARP = 35.0
"""A pair is far where, at `BESIDE` steps, it votes with less than a thirteenth of its weight."""
NEAR = 2.5
"""Pairs whose distances from their places differ by more spreads than this do not vote."""
VOTERS = 16
"""Seen objects that vote, those of the rarest classes: they have the fewest to be mistaken for."""


def heading_scores(mapped: MappedLayout, fragment: Fragment, candidates: Ints) -> Floats32:
    """(K, HEADINGS) float32 log-likelihood ratio of the seen objects: as mapped, against all invented.

    Args:
        mapped: the map.
        fragment: what is around the robot, n objects.
        candidates: (K,) rows of the map.

    """
    config = mapped.config
    voters = np.argsort(mapped.invented[fragment.classes], kind="stable")[:VOTERS]
    n, invented = len(voters), mapped.invented[fragment.classes[voters]]
    which, seen, there = same_class(mapped, fragment.classes[voters], candidates)
    offset = mapped.object_positions[there] - mapped.positions[candidates[which]]
    here = fragment.objects[voters[seen]]
    far_here, far_there = np.hypot(here[:, 0], here[:, 1]), np.hypot(offset[:, 0], offset[:, 1])
    along, up = far_here - far_there, here[:, 2] - offset[:, 2]
    # The robot stands beside the map's place, not on it.
    spread2 = config.spread_m**2
    close = (np.abs(along) <= NEAR * config.spread_m) & (np.abs(up) <= NEAR * config.height_spread_m)
    which, seen = which[close], seen[close]
    turn = (np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(here[:, 1], here[:, 0]))[close]
    fixed = along[close] ** 2 / spread2 + up[close] ** 2 / config.height_spread_m**2
    peak = mapped.detected[there[close]] / (2 * np.pi * spread2) / invented[seen] * np.exp(-0.5 * fixed)
    scale = 4 * far_here[close] * far_there[close] / spread2
    key = which * n + seen
    density = np.zeros(len(candidates) * n * HEADINGS)
    # Far from the robot a heading that is off by a few steps misses.
    for chosen, around in ((scale >= SHARP, BESIDE), (scale < SHARP, HEADINGS // 2)):
        nearest = np.rint(turn[chosen] / STEP).astype(np.int64)
        steps = nearest[:, None] + np.arange(-around, around + (around == BESIDE))
        across = np.sin((turn[chosen][:, None] - steps * STEP) / 2)
        votes = peak[chosen][:, None] * np.exp(-0.5 * scale[chosen][:, None] * across * across)
        at = key[chosen][:, None] * HEADINGS + steps % HEADINGS
        density += np.bincount(at.ravel(), votes.ravel(), len(density))
    gained: Floats = np.log1p(density).reshape(len(candidates), n, HEADINGS).sum(axis=1)
    return gained.astype(np.float32)


def same_class(mapped: MappedLayout, classes: Ints, candidates: Ints) -> tuple[Ints, Ints, Ints]:
    """All (candidate's number, seen object, mapped object) of one class, the mapped one near the candidate."""
    start, objects = mapped.objects_near
    size = start[candidates + 1] - start[candidates]
    there = objects[ranges(start[candidates], size)]
    which = np.repeat(np.arange(len(candidates)), size)
    order = np.argsort(classes, kind="stable")
    ordered = classes[order]
    low = np.searchsorted(ordered, mapped.object_classes[there], side="left")
    number = np.searchsorted(ordered, mapped.object_classes[there], side="right") - low
    return np.repeat(which, number), order[ranges(low, number)], np.repeat(there, number)


def best_poses(
    scores: Floats32, positions: Floats, building: Ints, most: int, apart_m: float
) -> tuple[Ints, NDArray[np.float64]]:
    """The best poses, none near a better one.

    Args:
        scores: (K, HEADINGS).
        positions: (K, 3) of the candidates, metres.
        building: (K,).
        most: how many.
        apart_m: two candidates nearer than this, with headings less than two steps apart, are one pose.

    Returns:
        (T,) candidates' numbers and (T,) headings in radians, best first.

    """
    peak = scores >= np.maximum(np.roll(scores, 1, axis=1), np.roll(scores, -1, axis=1))
    place, heading = np.nonzero(peak & (scores > 0))
    order = np.argsort(-scores[place, heading], kind="stable")[: 8 * most]
    place, heading = place[order], heading[order]
    free = np.ones(len(place), dtype=np.bool_)
    kept: list[int] = []
    at, of = positions[place], building[place]
    for i in range(len(place)):
        if not free[i]:
            continue
        kept.append(i)
        if len(kept) == most:
            break
        off = np.abs(at[i:] - at[i]).max(axis=1) < apart_m
        turned = np.abs(heading[i:] - heading[i])
        free[i:] &= ~(off & (of[i:] == of[i]) & (np.minimum(turned, HEADINGS - turned) <= 2))
    chosen = np.array(kept, dtype=np.int64)
    return place[chosen].astype(np.int64), (heading[chosen] * (2 * np.pi / HEADINGS)).astype(np.float64)
