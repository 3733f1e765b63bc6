"""How often the right place is among an encoder's first N: what a later stage that looks closer can still find.

The buildings and the database are those of `semloc_core.evaluate.relocalise`; asked is with whole graphs, and with what
a robot's graph holds after some metres (`semloc_core.sources.simulate.walks`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import Model, embed_graph, embed_places, similarity_matrix
from semloc_core.evaluate.relocalise import BASELINES, Arena, fitted, make_arena, read_buildings
from semloc_core.graph import Floats, GraphArrays, Ints, Labelspace, union
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig, walks_through

RANKS = (1, 10, 100, 300)
METRES = (0.0, 5.0, 10.0)
WALKS = 10
SHORTEST_M = 1.0

Asked = list[tuple[int, GraphArrays, Ints, Floats]]
"""Building, graph, the places (B,) of it that are asked about, and where they truly are (B, 3), metres."""


def evaluate_candidates(
    root: Path,
    *,
    models: Sequence[tuple[str, Model]] = (),
    baselines: Sequence[str] = BASELINES,
    metres: Sequence[float] = METRES,
    walks: int = WALKS,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@N of baselines and models, on whole query graphs and after some metres walked.

    Args:
        root: holds a folder a building, each with ``map.json`` and ``query.json``.
        models: trained models, each in its own labelspace, and what to call them.
        baselines: encoders with nothing to train; what they count they count on the maps.
        metres: lengths of the walks.
        walks: walks in each building for each of these lengths; the same for all methods.
        seed: of walks and bootstrap.
        progress: told of every method.

    Returns:
        For each method a row ``whole`` and one for each length: ``queries``, ``unknown`` (share of the queries' objects
        whose classes the method lacks), ``success@N`` for N in `RANKS` with 95 % bootstrap intervals over buildings.

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.

    """
    buildings = read_buildings(root)
    everything = union([file.labelspace for building in buildings for file in (building.map, building.query)])
    names = [*baselines, *(name for name, _ in models)]
    rows: list[Row] = []
    for i, name in enumerate(names):
        progress(i, len(names), name)
        given = dict(models).get(name)
        space: Labelspace = everything if given is None else given.labelspace
        arena = make_arena(buildings, space)
        rows += _judge(name, given or fitted(name, arena), arena, metres, walks, seed)
    progress(len(names), len(names), "done")
    return rows


def _judge(name: str, model: Model, arena: Arena, metres: Sequence[float], walks: int, seed: int) -> list[Row]:
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    classes = np.concatenate([query.object_classes for query in arena.queries])
    unknown = float((classes < 0).mean()) if len(classes) else 0.0
    asked: dict[str, Asked] = {
        "whole": [(b, q, np.arange(q.n_places), q.place_positions) for b, q in enumerate(arena.queries)]
    }
    for length in metres:
        asked[f"{length:g} m"] = _fragments(arena.queries, length, walks, seed)
    rows: list[Row] = []
    for scope, queries in asked.items():
        right, groups = list[NDArray[np.bool_]](), list[Ints]()
        for b, graph, places, truth in queries:
            best = metrics.top(similarity_matrix(embed_places(model, graph, places), database), max(RANKS))
            right.append(arena.right(best, b, truth, MATCH_RADIUS_M))
            groups.append(np.full(len(places), b, dtype=np.int64))
        if right:
            row: Row = {"method": name, "scope": scope, "queries": sum(map(len, right)), "unknown": unknown}
            rng, of = np.random.default_rng(seed), np.concatenate(groups)
            rows.append(row | metrics.success_figures(np.concatenate(right), rng, of, RANKS))
    return rows


def _fragments(queries: Sequence[GraphArrays], length: float, walks: int, seed: int) -> Asked:
    """Where the robot stands after so many metres, and what it has seen by then."""
    found: Asked = []
    for b, query in enumerate(queries):
        rng = np.random.default_rng([seed, b])
        for way in walks_through(query, WalkConfig(distance_m=max(length, SHORTEST_M)), rng, walks):
            step = int(np.searchsorted(way.metres, length).clip(max=way.steps - 1))
            part, place = way.part(step)
            found.append((b, part, np.array([place], dtype=np.int64), way.truth()[[step]]))
    return found
