"""How good a model is on places of its own map that it was not trained on: whole graphs, and a few metres walked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import Model, embed_graph, embed_places, similarity_matrix
from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig, walks_through
from semloc_core.training.config import PERTURBATIONS
from semloc_core.training.split import PARTS, Split
from semloc_core.training.views.perturb import perturb

QUERIES = 200
"""Held-out places that are asked about in all buildings together, at least, if so many runs (`MOST_RUNS`) have them."""
MOST_RUNS = 6
WALKS, WALK_M, STOPS = 8, 20.0, 5
"""Walks a run, their length (m), and held-out places on each at which the robot is asked, at most."""

Asked = tuple[int, GraphArrays, Ints, Floats]
"""Building, graph, the places (B,) of it that are asked about, and where they truly are (B, 3), metres."""


def own_validation(
    models: Mapping[str, Model],
    graphs: Sequence[GraphArrays],
    splits: Sequence[Split],
    seed: int,
    progress: Progress = no_progress,
) -> list[Row]:
    """Judge models on another run through their own buildings, as a detector would see it (`PERTURBATIONS`).

    Places are sampled anew, objects missed, invented and mislabelled. Asked about are only places of the split's
    ``test`` part, which neither trained the model nor chose its weights; all places of the buildings as mapped answer.
    ``whole``: the run's whole graph is known; ``fragment``: what was within 4 m of a walk of up to `WALK_M` (encoders
    that read stars). All models answer the same queries.

    Args:
        models: what to call each, and the model; of one labelspace.
        graphs: the buildings, as mapped.
        splits: their splits as in training.
        seed: of the runs and walks.
        progress: called with what is done of the runs made, and then of the queries of all models.

    Returns:
        For each model and scope: ``queries`` and ``success@N`` for N in `metrics.RANKS`, right being within 4 m in the
        right building; no row of a scope without queries.

    """
    first = next(iter(models.values()))
    whole, parts = list[Asked](), list[Asked]()
    for b, (graph, split) in enumerate(zip(graphs, splits, strict=True)):
        held_out, asked = int(split.mask("test").sum()), 0
        for run in range(MOST_RUNS):
            progress(b * MOST_RUNS + run, len(graphs) * MOST_RUNS, "another run through each building")
            if not held_out or asked >= QUERIES / len(graphs):
                break
            rng = np.random.default_rng([seed, _STREAM, b, run])
            seen = perturb(graph, first.labelspace, PERTURBATIONS["detector"], rng)
            test = split.parts_of(seen) == PARTS.index("test")
            whole.append((b, seen, np.flatnonzero(test), seen.place_positions[test]))
            asked += len(whole[-1][2])
            if first.encoder.extraction.kind == "reach":
                parts += _fragments(b, seen, test, rng)
    done, total = 0, len(models) * (len(whole) + len(parts))
    rows: list[Row] = []
    for name, model in models.items():
        progress(done, total, name)
        database = np.concatenate([embed_graph(model, graph) for graph in graphs])
        for scope, asked_of in (("whole", whole), ("fragment", parts)):
            right: list[NDArray[np.bool_]] = []
            for query in asked_of:
                if len(query[2]):
                    right.append(_right(model, query, graphs, database))
                done += 1
                progress(done, total, f"{name}, {scope}")
            if right:
                hits = np.concatenate(right)
                row: Row = {"method": name, "scope": scope, "queries": len(hits)}
                rows.append(row | {f"success@{n}": float(hits[:, :n].any(axis=1).mean()) for n in metrics.RANKS})
    return rows


_STREAM = 9
"""Of randomness under the seed; see `semloc_core.training.loop`."""


def _fragments(building: int, seen: GraphArrays, test: NDArray[np.bool_], rng: np.random.Generator) -> list[Asked]:
    found: list[Asked] = []
    for way in walks_through(seen, WalkConfig(distance_m=WALK_M), rng, WALKS):
        steps = np.flatnonzero(test[way.places])
        for step in rng.permutation(steps)[:STOPS].tolist():
            part, place = way.part(step)
            found.append((building, part, np.array([place], dtype=np.int64), way.truth()[[step]]))
    return found


def _right(
    model: Model, query: Asked, graphs: Sequence[GraphArrays], database: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """(B, N) whether each of a query's places is right at each rank; ``database``: (M, D), of the graphs' places."""
    positions = np.concatenate([graph.place_positions for graph in graphs])
    building = np.repeat(np.arange(len(graphs)), [graph.n_places for graph in graphs])
    b, graph, places, truth = query
    best = metrics.top(similarity_matrix(embed_places(model, graph, places), database), max(metrics.RANKS))
    away = np.linalg.norm(positions[best] - truth[:, None], axis=2)
    found: NDArray[np.bool_] = (away <= MATCH_RADIUS_M) & (building[best] == b)
    return found
