"""Online: a robot has walked a few metres, its graph is a fragment: in which building, and where in it, it is.

ROOT/*/query.json is revealed along walks and asked against ROOT/*/map.json, all maps in one database. A match is
right in the same building and within 4 m, as in `semloc_core.evaluate.relocalise`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.evaluate import metrics
from semloc_core.evaluate.agreement import Agreement
from semloc_core.evaluate.fragments import answered, embed_walk, surroundings_along
from semloc_core.evaluate.relocalise import Arena, fitted, make_arena, read_buildings
from semloc_core.evaluate.rows import Progress, Row, no_progress
from semloc_core.evaluate.walks import Walk, WalkConfig, walk
from semloc_core.graph_arrays import Ints
from semloc_core.labelspace import union
from semloc_core.model import Model, embed_graph
from semloc_core.sequence import FilterConfig, MapModel, PlaceFilter, map_model

ENCODERS = ("bag_of_words", "rings")
SCOPES_M = (0.0, 5.0, 10.0, 20.0, 40.0)
"""Metres walked at which an answer is judged: the first one from there on."""

Bools = NDArray[np.bool_]
Similarities = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class OnlineWalk:
    """A walk, and the building (an index) that it is in."""

    building: int
    walk: Walk


def evaluate_online(
    root: Path,
    *,
    models: Sequence[Model] = (),
    encoders: Sequence[str] = ENCODERS,
    config: WalkConfig | None = None,
    walks: int = 10,
    scopes_m: Sequence[float] = SCOPES_M,
    filtered: bool = True,
    bound: bool = True,
    radius_m: float = MATCH_RADIUS_M,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@1/5/10 by metres walked.

    Args:
        root: holds a folder a building, each with ``map.json`` and ``query.json``.
        models: trained models to judge, each in its own labelspace; ``method`` is the encoder's name and the first
            digits of the model's hash.
        encoders: encoders with nothing to train; what they count they count on the maps.
        config: how the robot walks and what it sees; ``distance_m`` is overridden by the last scope.
        walks: walks a building, on average: a building has them by its number of places, so that the robot is
            equally likely to start at any place of any building.
        scopes_m: metres walked at which answers are judged.
        filtered: judge each method with the filter over places (`semloc_core.sequence`) too.
        bound: judge `semloc_core.evaluate.agreement` too.
        radius_m: how near is right.
        seed: of walks and bootstrap.
        progress: told of every method and building.

    Returns:
        For each method, for ``filter`` ``none`` and ``bayes``, for ``home`` ``any`` (all buildings are searched) and
        ``known`` (only the one that the robot is in), a row a scope (``0m``, ``5m`` …): ``success@N`` with a 95 %
        bootstrap interval ``_low``, ``_high`` over buildings (over walks where there is only one) and ``queries``,
        one a walk.

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.
        GraphError: a building without places to walk between.

    """
    buildings = read_buildings(root)
    labelspace = union([file.labelspace for building in buildings for file in (building.map, building.query)])
    arena = make_arena(buildings, labelspace)
    config = msgspec.structs.replace(config or WalkConfig(), distance_m=max(*scopes_m, 1e-9))
    total = len(encoders) + len(models) + bound
    rows: list[Row] = []
    paths = make_walks(arena, config, walks, seed)
    places = read_maps(arena, radius_m) if filtered else None
    for done, name in enumerate(encoders):
        progress(done, total, name)
        rows += judge_online(name, fitted(name, arena), arena, paths, scopes_m, radius_m, seed, places)
    for done, model in enumerate(models, len(encoders)):
        name = f"{model.encoder.name} {model.hash[:8]}"
        progress(done, total, name)
        own, its, places_of_own = arena, paths, places
        if model.labelspace.hash != labelspace.hash:
            own = make_arena(buildings, model.labelspace)
            its = make_walks(own, config, walks, seed)
            places_of_own = read_maps(own, radius_m) if filtered else None
        rows += judge_online(name, model, own, its, scopes_m, radius_m, seed, places_of_own)
    if bound:
        progress(total - 1, total, "agreement")
        agreement = Agreement(arena.maps, len(arena.labelspace))
        mapped = replace(arena, queries=arena.maps)
        for name, seen in (("agreeing places", arena), ("agreeing places, perfect detector", mapped)):
            paths = make_walks(seen, config, walks, seed)
            rows += judge_agreement(name, agreement, arena, paths, scopes_m, config.range_m, radius_m, seed)
    progress(total, total, "done")
    return rows


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


def judge_online(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
    seed: int,
    places: MapModel | None = None,
) -> list[Row]:
    """The rows of one encoder; see `evaluate_online`. Without ``places`` there are none with the filter."""
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    variants = [(f, home) for f in (("none", "bayes") if places else ("none",)) for home in ("any", "known")]
    verdicts = {v: np.zeros((len(paths), len(scopes_m), max(metrics.RANKS)), np.bool_) for v in variants}
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        if places is None:
            similarity = metrics.similarity_matrix(embed_walk(model, path.walk.at(at)), database)
        else:
            every = metrics.similarity_matrix(embed_walk(model, path.walk), database)
            similarity = every[at]
            evidence = places.evidence(surroundings_along(path.walk, model.encoder.n_classes), every, FilterConfig())
        for (filter_, home), right in verdicts.items():
            only = arena.building == path.building if home == "known" else np.ones(len(database), np.bool_)
            if filter_ == "none" or places is None:
                best = metrics.top(np.where(only, similarity, np.float32(-2)), max(metrics.RANKS))
            else:
                best = believed(PlaceFilter(places, only=only), path.walk, evidence, at)
            right[i] = verdict(arena, path, at, best, radius_m)
    rows = []
    for (filter_, home), right in verdicts.items():
        rows += _rows({"method": method, "filter": filter_, "home": home}, right, paths, scopes_m, seed)
    return rows


def believed(filter_: PlaceFilter, walk: Walk, evidence: Similarities, at: Ints) -> Ints:
    """(K, 10) the filter's answers at K steps of a walk, -1 where it has no more.

    Args:
        filter_: goes on from what it believes.
        walk: T steps; the displacement from place to place, as perceived, stands for odometry.
        evidence: (T, M), of `MapModel.evidence`.
        at: (K,) steps.

    """
    moves = np.diff(walk.graph.place_positions[walk.places], axis=0)
    walked = np.concatenate([[0.0], np.linalg.norm(moves, axis=1)])
    answers = np.full((len(at), max(metrics.RANKS)), -1, dtype=np.int64)
    for step in range(walk.steps):
        filter_.update(evidence[step], float(walked[step]))
        for row in np.flatnonzero(at == step):
            found, _ = filter_.ranking(answers.shape[1])
            answers[row, : len(found)] = found
    return answers


def judge_agreement(
    method: str,
    agreement: Agreement,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    range_m: float,
    radius_m: float,
    seed: int,
) -> list[Row]:
    """How far the objects seen could lead at all: the rows of `semloc_core.evaluate.agreement`."""
    positions, building = arena.positions, arena.building
    share = np.zeros((len(paths), len(scopes_m)))
    number = np.zeros((len(paths), len(scopes_m)))
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        unexplained = agreement.unexplained(path.walk, at, range_m)
        away = np.linalg.norm(positions - path.walk.truth()[at][:, None], axis=2)
        right = (away <= radius_m) & (building == path.building)
        best = np.where(right, unexplained, np.inf).min(axis=1)
        agree = unexplained <= best[:, None]
        number[i] = agree.sum(axis=1)
        share[i] = (agree & right).sum(axis=1) / np.maximum(number[i], 1)
    rows: list[Row] = []
    rng = np.random.default_rng(seed)
    groups = _groups(paths)
    for column, metres in enumerate(scopes_m):
        low, high = metrics.bootstrap_interval(share[:, column], rng, groups=groups)
        rows.append(
            {
                "method": method,
                "filter": "none",
                "home": "any",
                "scope": f"{metres:g}m",
                "queries": len(paths),
                "success@1": float(share[:, column].mean()),
                "success@1_low": low,
                "success@1_high": high,
                "agreeing": float(np.median(number[:, column])),
            }
        )
    return rows


def steps_at(walk: Walk, scopes_m: Sequence[float]) -> Ints:
    """The first step at each distance or beyond; the last one where the walk ends (by a rounding) before."""
    return np.minimum(np.searchsorted(walk.metres, scopes_m), walk.steps - 1).astype(np.int64)


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
    away = np.linalg.norm(arena.positions[best] - asked.truth()[:, None], axis=2)
    right: Bools = (away <= radius_m) & (arena.building[best] == path.building) & (best >= 0)
    right &= answered(asked)[:, None]
    missing = max(metrics.RANKS) - right.shape[1]
    return np.pad(right, ((0, 0), (0, missing)))


def _rows(keys: Row, right: Bools, paths: Sequence[OnlineWalk], scopes_m: Sequence[float], seed: int) -> list[Row]:
    """A row a scope of verdicts (W, K, 10)."""
    rng = np.random.default_rng(seed)
    groups = _groups(paths)
    rows: list[Row] = []
    for column, metres in enumerate(scopes_m):
        row: Row = {**keys, "scope": f"{metres:g}m", "queries": len(paths)}
        for n in metrics.RANKS:
            success: Bools = right[:, column, :n].max(axis=1)
            low, high = metrics.bootstrap_interval(success, rng, groups=groups)
            row |= {f"success@{n}": float(success.mean()), f"success@{n}_low": low, f"success@{n}_high": high}
        rows.append(row)
    return rows


def _groups(paths: Sequence[OnlineWalk]) -> Ints | None:
    groups = np.array([path.building for path in paths], dtype=np.int64)
    return groups if len(np.unique(groups)) > 1 else None
