"""Walks through the buildings of an arena, and the answers along them, with the filter and without."""

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
from semloc_core.tracking import MapModel, PlaceFilter, map_model

Bools = NDArray[np.bool_]
Similarities = NDArray[np.float32]


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


def read_maps(arena: Arena, radius_m: float) -> MapModel:
    """What the filter needs of an arena's maps."""
    graphs = [graph.to_scene_graph(arena.labelspace) for graph in arena.maps]
    return map_model(graphs, arena.labelspace, radius_m=radius_m)


def believed(filter_: PlaceFilter, walk: Walk, evidence: Similarities, at: Ints, chances: Floats | None = None) -> Ints:
    """(K, 10) the filter's answers at K steps of a walk, -1 where it has no more.

    Args:
        filter_: goes on from what it believes.
        walk: T steps; the displacement from place to place, as perceived, stands for odometry.
        evidence: (T, M), of `MapModel.evidence`.
        at: (K,) steps.
        chances: (K,) where to put the probability of the best answer at each of these steps.

    """
    moves = np.diff(walk.graph.place_positions[walk.places], axis=0)
    walked = np.concatenate([[0.0], np.linalg.norm(moves, axis=1)])
    answers = np.full((len(at), max(metrics.RANKS)), -1, dtype=np.int64)
    for step in range(walk.steps):
        filter_.update(evidence[step], float(walked[step]))
        for row in np.flatnonzero(at == step):
            found, probability = filter_.ranking(answers.shape[1])
            answers[row, : len(found)] = found
            if chances is not None:
                chances[row] = probability[0]
    return answers


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
