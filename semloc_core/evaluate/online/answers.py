"""Walks through the buildings of an arena, and the answers along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.evaluate.online.fragments import answered
from semloc_core.evaluate.relocalise import Arena
from semloc_core.graph import Floats, Ints
from semloc_core.sources import Walk, WalkConfig, walk
from semloc_core.text import short_repr

Bools = NDArray[np.bool_]


@short_repr
@dataclass(frozen=True, eq=False)
class OnlineWalk:
    """A walk, and the building (an index) that it is in."""

    building: int
    walk: Walk


def make_walks(arena: Arena, config: WalkConfig, walks: int, seed: int) -> list[OnlineWalk]:
    """Walks through all buildings of an arena; the same ones whatever its labelspace."""
    places = np.array([query.n_places for query in arena.queries])
    number = np.maximum(1, np.rint(walks * len(places) * places / places.sum())).astype(np.int64)
    return [
        OnlineWalk(building, walk(arena.queries[building], config, np.random.default_rng([seed, building, i])))
        for building in range(len(places))
        for i in range(int(number[building]))
    ]


def steps_at(walk: Walk, scopes_m: Sequence[float]) -> Ints:
    """The first step at each distance or beyond; the last one where the walk ends (by a rounding) before."""
    return np.minimum(np.searchsorted(walk.metres, scopes_m), walk.steps - 1).astype(np.int64)


def by_chance(arena: Arena, path: OnlineWalk, at: Ints, radius_m: float, *, known: bool = False) -> Floats:
    """(K,) the share of the database's places that are right (`verdict`) at K steps: success@1 of a blind guess.

    Args:
        arena: its maps are the database.
        path: the walk.
        at: (K,) steps.
        radius_m: how near is right.
        known: guess in the robot's building alone.

    """
    rows = np.flatnonzero(arena.building == path.building) if known else np.arange(len(arena.building))
    found: Floats = verdict(arena, path, at, np.tile(rows, (len(at), 1)), radius_m)[:, : len(rows)].mean(axis=1)
    return found


def verdict(arena: Arena, path: OnlineWalk, at: Ints, best: Ints, radius_m: float) -> Bools:
    """(K, 10) whether each answer is right, at K steps.

    Args:
        arena: its maps are the database of M places.
        path: the walk.
        at: (K,) steps.
        best: (K, 10) rows of the database, best first; -1 is no answer, and none is given where the robot's place
            has no neighbour.
        radius_m: how near is right.

    """
    asked = path.walk.at(at)
    right: Bools = arena.right(best, path.building, asked.truth(), radius_m) & (best >= 0)
    right &= answered(asked)[:, None]
    missing = max(max(metrics.RANKS) - right.shape[1], 0)
    return np.pad(right, ((0, 0), (0, missing)))
