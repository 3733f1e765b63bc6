"""What merging later traversals into a map is good for: success@1 on a traversal to come, before and after.

The map holds all buildings. Each is mapped by a first traversal; later ones, in frames of their own, are merged into
it one after the other; another one still is asked, place by place. Beside the merged map stand the alternatives: the
first traversal alone, the newest one put in its place, and the merged map with all objects weighing the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.errors import MapError
from semloc_core.evaluate.merge_cases import Case, misplaced_m
from semloc_core.graph import GraphArrays, Labelspace, SceneGraph, storey_at
from semloc_core.map_database import History, class_weights, move_rates, object_weights
from semloc_core.map_merge import MergeConfig, Side, Transform, merge, side
from semloc_core.metrics import Progress, Row, no_progress

RIGHT_M = 0.5
"""A traversal is laid right if its places end up this near to where they belong (root mean square), metres."""

Embeddings = NDArray[np.float32]


@dataclass(eq=False)
class _Life:
    """A building's map as traversals are merged into it."""

    graph: SceneGraph
    history: History = field(default_factory=History)
    accepted: int = 0
    right: int = 0


@dataclass(frozen=True, eq=False)
class _Map:
    """All buildings, embedded.

    Args:
        positions: (P, 3) of each building.
        storeys: (P,) of each.
        embeddings: (P, D) of each.
        of_class: what each class weighs.

    """

    positions: tuple[NDArray[np.float64], ...]
    storeys: tuple[NDArray[np.int64], ...]
    embeddings: tuple[Embeddings, ...]
    of_class: dict[str, float]


def evaluate_merge(
    space: Labelspace,
    cases: Sequence[Case],
    models: Sequence[tuple[str, Model]],
    *,
    config: MergeConfig | None = None,
    radius_m: float = MATCH_RADIUS_M,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@1 before and after merges; alignments accepted and right; traversals of other buildings refused.

    Args:
        space: the cases' labelspace.
        cases: the buildings.
        models: what embeds, by name, each in this labelspace.
        config: options of the merge.
        radius_m: how near is right.
        seed: of the bootstrap.
        progress: told of every building.

    Returns:
        For each model, query (``scope``) and ``map``: ``success@1`` and ``success@5`` with 95 % bootstrap intervals
        over buildings, ``gain`` over the map of the first traversal with such an interval of the paired difference,
        and ``queries``. Then for each model a row ``merges`` (``tried``, ``accepted``, ``right``), a row ``foreign``
        (``tried``, ``refused``), and for each class a row: the share that was learnt to move, and the true one.

    """
    config = config or MergeConfig()
    rows: list[Row] = []
    steps = max(len(case.visits) for case in cases)
    for number, (name, model) in enumerate(models):

        def report(done: int, number: int = number, name: str = name) -> None:
            progress(number * steps + done, len(models) * steps, name)

        lives, maps = _live(cases, model, config, report)
        rows += _success(name, model, cases, maps, radius_m, seed)
        tried = sum(len(case.visits) for case in cases)
        accepted, right = sum(life.accepted for life in lives), sum(life.right for life in lives)
        rows.append({"method": name, "scope": "merges", "tried": tried, "accepted": accepted, "right": right})
        rows.append({"method": name, "scope": "foreign", **_foreign(cases, model, config)})
        rows += _moves(name, cases, lives)
    progress(1, 1, "done")
    return rows


def _live(
    cases: Sequence[Case], model: Model, config: MergeConfig, report: Callable[[int], None]
) -> tuple[list[_Life], dict[str, _Map]]:
    """Merge traversal after traversal into all buildings; the map after each."""
    space = model.labelspace
    lives = [_Life(case.first.to_scene_graph(space)) for case in cases]
    maps = {"first traversal": _embed(lives, model)}
    again = [_merged(lives, i, life.graph, model, config, cases[i].name) for i, life in enumerate(lives)]
    maps["first traversal merged with itself"] = _embed(again, model)
    steps = max(len(case.visits) for case in cases)
    for step in range(steps):
        report(step)
        for i, case in enumerate(cases):
            visit = case.visits[step]
            try:
                life = _merged(lives, i, visit.graph, model, config, case.name, visit.truth)
            except MapError:
                continue  # the map stays as it is
            lives[i] = life
        maps[f"{step + 1} merged"] = _embed(lives, model)
        if step in (0, steps - 1):
            plain = [_Life(life.graph) for life in lives]
            maps[f"{step + 1} merged, all weights 1"] = _embed(plain, model)
            newest = [_Life(_moved(case.visits[step].graph, case.visits[step].truth, model)) for case in cases]
            maps[f"traversal {step + 2} in its place"] = _embed(newest, model)
    return lives, maps


def _merged(
    lives: Sequence[_Life],
    number: int,
    graph: SceneGraph,
    model: Model,
    config: MergeConfig,
    name: str,
    truth: Transform | None = None,
) -> _Life:
    """A building with a traversal merged; whether it was laid right is counted where the truth is known."""
    life = lives[number]
    of_class = _of_class(lives, model)
    others = [other.history.classes for i, other in enumerate(lives) if i != number]
    seen = side(model, graph, of_class)
    merged = merge(_side(life, model, of_class), life.history, seen, others=others, config=config, name=name)
    right = truth is not None and (
        misplaced_m(merged.alignment.transform, truth, seen.arrays.place_positions) <= RIGHT_M
    )
    return _Life(merged.graph, merged.history, life.accepted + 1, life.right + right)


def _of_class(lives: Sequence[_Life], model: Model) -> dict[str, float]:
    return class_weights([life.history.classes for life in lives], model.labelspace)


def _side(life: _Life, model: Model, of_class: dict[str, float]) -> Side:
    arrays = GraphArrays.from_scene_graph(life.graph, model.labelspace)
    weights = object_weights(life.graph, model.labelspace, life.history, of_class)
    return Side.of(life.graph, model.labelspace, embed_graph(model, arrays, weights))


def _embed(lives: Sequence[_Life], model: Model) -> _Map:
    of_class = _of_class(lives, model)
    sides = [_side(life, model, of_class) for life in lives]
    return _Map(
        tuple(each.arrays.place_positions for each in sides),
        tuple(each.arrays.storeys for each in sides),
        tuple(each.embeddings for each in sides),
        of_class,
    )


def _moved(graph: SceneGraph, transform: Transform, model: Model) -> SceneGraph:
    """A graph in another frame."""
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace)
    positions, objects = transform.apply(arrays.place_positions), transform.apply(arrays.object_positions)
    return replace(arrays, place_positions=positions, object_positions=objects).to_scene_graph(model.labelspace)


def _success(
    name: str, model: Model, cases: Sequence[Case], maps: dict[str, _Map], radius_m: float, seed: int
) -> list[Row]:
    rows: list[Row] = []
    for scope in cases[0].queries:
        asked = [case.queries[scope] for case in cases]
        groups = np.repeat(np.arange(len(asked)), [query.n_places for query in asked]).astype(np.int64)
        before: NDArray[np.bool_] | None = None
        for map_name, map_ in maps.items():
            right = _right(asked, model, map_, radius_m)
            before = right if before is None else before
            rng = np.random.default_rng(seed)
            row: Row = {"method": name, "scope": scope, "map": map_name, "queries": len(right)}
            row |= metrics.success_figures(right, rng, groups, (1, 5))
            row |= metrics.with_interval("gain", right[:, 0].astype(np.float64) - before[:, 0], rng, groups)
            rows.append(row)
    return rows


def _right(asked: Sequence[GraphArrays], model: Model, map_: _Map, radius_m: float) -> NDArray[np.bool_]:
    """(Q, 5) whether each answer is right: near enough, in the right building and on the right storey."""
    database, positions = np.concatenate(map_.embeddings), np.concatenate(map_.positions)
    building = np.repeat(np.arange(len(map_.positions)), [len(each) for each in map_.positions])
    storey = np.concatenate(map_.storeys)
    found = []
    for number, query in enumerate(asked):
        classes = [*model.labelspace.classes, ""]
        of_object = [map_.of_class.get(classes[c], 1.0) for c in query.object_classes.tolist()]
        z = embed_graph(model, query, dict(zip(query.object_ids, of_object, strict=True)))
        best = metrics.top(similarity_matrix(z, database), 5)
        away = np.linalg.norm(positions[best] - query.place_positions[:, None], axis=2)
        own = building == number
        truth = [storey_at(point, positions[own], storey[own]) for point in query.place_positions]
        near = (away <= radius_m) & (building[best] == number)
        found.append(near & (storey[best] == np.array(truth, dtype=np.int64)[:, None]))
    return np.concatenate(found)


def _foreign(cases: Sequence[Case], model: Model, config: MergeConfig) -> dict[str, int]:
    """How many traversals of another building are refused: each building is offered the next one's."""
    refused = 0
    for case, other in zip(cases, [*cases[1:], *cases[:1]], strict=True):
        plain = dict.fromkeys(model.labelspace.classes, 1.0)
        mapped = side(model, case.first.to_scene_graph(model.labelspace), plain)
        try:
            merge(mapped, History(), side(model, other.visits[0].graph, plain), config=config)
        except MapError:
            refused += 1
    return {"tried": len(cases), "refused": refused}


def _moves(name: str, cases: Sequence[Case], lives: Sequence[_Life]) -> list[Row]:
    """For each class the share that moves, as learnt in all buildings, and the true one where it is known."""
    learnt = move_rates([life.history.classes for life in lives], cases[0].moves)
    return [
        {"method": name, "scope": class_, "moves_learnt": learnt[class_], "moves_true": true}
        for class_, true in sorted(cases[0].moves.items(), key=lambda item: -item[1])
        if any(class_ in life.history.classes for life in lives)
    ]
