"""Whole buildings, many at once: in which building, and where in it, is a place that a second run has seen.

ROOT/*/query.json against ROOT/*/map.json, all maps in one database. Nothing is shared between a query and its map
but the building: places are sampled anew, objects are as a detector saw them. A match is right in the same building
within 4 m and on the same storey; that of the truth is told by the building's own map (`semloc_core.graph.storeys`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import (
    GENERAL,
    Model,
    build_encoder,
    embed_graph,
    extract_all,
    general_model,
    similarity_matrix,
)
from semloc_core.errors import FileFormatError
from semloc_core.evaluate.verified_answers import add_error, any_frame, layout_verifier, reranked, written_in
from semloc_core.graph import Floats, GraphArrays, Ints, Labelspace, Reading, SceneGraph, storey_at, union
from semloc_core.matching import Placed, fragment_of_arrays
from semloc_core.metrics import PoseErrors, Progress, Row, accepted_share, expected_calibration_error, no_progress
from semloc_core.sources import HydraFile, read_hydra
from semloc_core.text import short_repr
from semloc_core.training import Report, TrainConfig, train

BASELINES = ("bag_of_words", "tfidf", "histogram", "rings", GENERAL)


@short_repr
@dataclass(frozen=True, eq=False)
class Building:
    """A building mapped and seen again."""

    name: str
    map: HydraFile
    query: HydraFile


@short_repr
@dataclass(frozen=True, eq=False)
class Arena:
    """All buildings as arrays in one labelspace; the database is the places of all maps, building by building.

    Args:
        labelspace: the classes.
        maps: one a building; those after the last query are in the map and are not asked about.
        queries: one of each of the first buildings, in the same order.

    """

    labelspace: Labelspace
    maps: tuple[GraphArrays, ...]
    queries: tuple[GraphArrays, ...]

    @property
    def positions(self) -> Floats:
        """(M, 3) positions of the database's places, each in its building's frame (m)."""
        return np.concatenate([building.place_positions for building in self.maps])

    @property
    def building(self) -> Ints:
        """(M,) index of the building of each of the database's places."""
        return np.repeat(np.arange(len(self.maps)), [building.n_places for building in self.maps]).astype(np.int64)

    @cached_property
    def storey(self) -> Ints:
        """(M,) number of the storey of each of the database's places, in its building."""
        return np.concatenate([building.storeys for building in self.maps])

    def truth_storeys(self, building: int, truth: Floats) -> Ints:
        """(K,) the storeys that (K, 3) points of a building are on, by its own map."""
        mapped = self.maps[building]
        if not mapped.storeys.any():
            return np.zeros(len(truth), dtype=np.int64)
        return np.array([storey_at(p, mapped.place_positions, mapped.storeys) for p in truth], dtype=np.int64)

    def right(self, best: Ints, building: int, truth: Floats, radius_m: float) -> NDArray[np.bool_]:
        """(K, N) whether answers are within the radius and on the storey of where the robot is.

        Args:
            best: (K, N) rows of the database.
            building: that the robot is in.
            truth: (K, 3) where in it, metres.
            radius_m: how near is right.

        """
        away = np.linalg.norm(self.positions[best] - truth[:, None], axis=2)
        found: NDArray[np.bool_] = (away <= radius_m) & (self.building[best] == building)
        found &= self.storey[best] == self.truth_storeys(building, truth)[:, None]
        return found

    def chance(self, building: int, radius_m: float) -> Floats:
        """(Q,) the share of all places that are right for each query of a building: success@1 of a blind guess."""
        every = np.arange(len(self.building))[None]
        found: Floats = self.right(every, building, self.queries[building].place_positions, radius_m).mean(axis=1)
        return found


def evaluate_relocalise(
    root: Path,
    *,
    models: Sequence[Model] = (),
    train_paper: bool = True,
    verified: bool = True,
    baselines: Sequence[str] = BASELINES,
    config: TrainConfig | None = None,
    radius_m: float = MATCH_RADIUS_M,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@1/5/10 of baselines and models on every building of a folder.

    Args:
        root: holds a folder a building, each with ``map.json`` and ``query.json``.
        models: trained models to judge too, each in its own labelspace; ``method`` is the encoder's name and the
            first digits of the model's hash.
        train_paper: train the paper's encoder on all maps (never on a query) and judge it too.
        verified: judge rings and each model with answers verified by layout too, as method ``METHOD + layout``, each
            query in a frame of its own; rows hold ``ece`` (`expected_calibration_error` of the probability of the
            best match), and one of scope ``foreign`` says what is accepted (`accepted_share`, by that probability)
            with the query's building left out of the database.
        baselines: encoders with nothing to train; what they count they count on the maps.
        config: options of the training; encoder and seed are overridden.
        radius_m: how near is right.
        seed: of training and of the bootstrap.
        progress: told of every method, and of the training's steps.

    Returns:
        For each method a row for ``all`` and one a building: ``success@N`` for N = 1, 5, 10 with a 95 % bootstrap
        interval ``_low``, ``_high``, ``queries``, and ``chance`` (`Arena.chance`, averaged). A building's interval is
        over its queries; that of ``all`` over buildings, since what can vary is which buildings a robot meets (over
        queries where there is only one).

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.

    """
    buildings = read_buildings(root)
    labelspace = union([file.labelspace for building in buildings for file in (building.map, building.query)])
    arena = make_arena(buildings, labelspace)
    steps = (config or TrainConfig()).steps if train_paper else 0
    total = steps + len(baselines) + len(models)
    done = 0
    rows: list[Row] = []
    for name in baselines:
        progress(done, total, name)
        baseline = fitted(name, arena)
        rows += judge_arena(name, baseline, arena, radius_m, seed)
        if verified and name == "rings":
            rows += judge_layout(name, baseline, arena, radius_m, seed)
        done += 1
    if train_paper:
        begun = done

        def report(step: Report) -> None:
            progress(begun + step.step, total, "training paper")

        chosen = msgspec.structs.replace(config or TrainConfig(), encoder="paper", seed=seed)
        result = train(arena.maps, labelspace, chosen, progress=report)
        done += steps
        rows += judge_arena("paper", result.model, arena, radius_m, seed)
    for model in models:
        name = f"{model.encoder.name} {model.hash[:8]}"
        progress(done, total, name)
        own = arena if model.labelspace.hash == labelspace.hash else make_arena(buildings, model.labelspace)
        rows += judge_arena(name, model, own, radius_m, seed)
        if verified:
            rows += judge_layout(name, model, own, radius_m, seed)
        done += 1
    progress(total, total, "done")
    return rows


def read_buildings(root: Path) -> list[Building]:
    """Read ROOT/*/map.json and query.json, sorted by folder name.

    Raises:
        FileFormatError: no folder with both.

    """
    folders = sorted(path.parent for path in root.glob("*/map.json") if (path.parent / "query.json").exists())
    if not folders:
        raise FileFormatError(f"expected folders with map.json and query.json in {root} (got none)")
    return [
        Building(folder.name, read_hydra(folder / "map.json"), read_hydra(folder / "query.json")) for folder in folders
    ]


def read_distractors(folders: Sequence[Path]) -> list[HydraFile]:
    """Read DIR/*.json and DIR/*/map.json of each folder, sorted by path: buildings that are only in the map.

    Raises:
        FileFormatError: a folder without any.

    """
    found: list[HydraFile] = []
    for folder in folders:
        paths = sorted([*folder.glob("*.json"), *folder.glob("*/map.json")])
        if not paths:
            raise FileFormatError(f"expected scene graphs, *.json or */map.json, in {folder} (got none)")
        found += [read_hydra(path) for path in paths]
    return found


def relabelled(buildings: Sequence[Building], names: Mapping[str, str]) -> list[Building]:
    """The buildings as asked by a detector of another label set, whose names the cross-walk leads back to the maps'.

    Args:
        buildings: maps and queries of one label set.
        names: a name of theirs -> the other detector's; ``unknown`` where it has none. Others are its own too.

    """
    space = union([building.map.labelspace for building in buildings])
    often = Counter(thing.class_ for building in buildings for thing in building.map.graph.objects.values())
    labels = Reading(auto=True).with_known(space, often).labels()

    def said(graph: SceneGraph) -> SceneGraph:
        things = {
            i: msgspec.structs.replace(thing, class_=names.get(thing.class_, thing.class_), labels=None)
            for i, thing in graph.objects.items()
        }
        return labels.graph(replace(graph, objects=things))

    return [replace(b, query=replace(b.query, graph=said(b.query.graph), labelspace=space)) for b in buildings]


def make_arena(buildings: Sequence[Building], labelspace: Labelspace, distractors: Sequence[HydraFile] = ()) -> Arena:
    """Freeze all buildings in one labelspace; objects of classes that it lacks say nothing."""
    maps, queries = (
        [GraphArrays.from_scene_graph(file.graph, labelspace, building.name) for building, file in files]
        for files in ([(b, b.map) for b in buildings], [(b, b.query) for b in buildings])
    )
    maps += [
        GraphArrays.from_scene_graph(file.graph, labelspace, f"distractor {number}")
        for number, file in enumerate(distractors)
    ]
    return Arena(labelspace, tuple(maps), tuple(queries))


def fitted(name: str, arena: Arena) -> Model:
    """An encoder with nothing to train, what it counts counted on all maps; the general one, fitted to them."""
    if name == GENERAL:
        return general_model(arena.maps, arena.labelspace)
    encoder = build_encoder(name, None, len(arena.labelspace))
    encoder.fit(extract_all(graph, len(arena.labelspace), encoder.extraction) for graph in arena.maps)
    return Model(encoder, arena.labelspace)


def judge_arena(method: str, model: Model, arena: Arena, radius_m: float, seed: int) -> list[Row]:
    """The rows of one method; see `evaluate_relocalise`."""
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    right = []
    for index, query in enumerate(arena.queries):
        best = metrics.top(similarity_matrix(embed_graph(model, query), database), max(metrics.RANKS))
        right.append(arena.right(best, index, query.place_positions, radius_m))
    rng = np.random.default_rng(seed)
    names = [query.name for query in arena.queries]
    of_building = np.repeat(np.arange(len(right)), [len(found) for found in right]).astype(np.int64)
    rows = [_row(method, "all", np.concatenate(right), rng, of_building if len(right) > 1 else None)]
    rows += [_row(method, name, found, rng, None) for name, found in zip(names, right, strict=True)]
    return _with_chance(rows, arena, radius_m)


def judge_layout(method: str, model: Model, arena: Arena, radius_m: float, seed: int) -> list[Row]:
    """The rows of one method whose answers are verified by layout; see `evaluate_relocalise`."""
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    building = arena.building
    verifier = layout_verifier(arena.maps, len(arena.labelspace))
    right, sure, abroad = [], [], []
    errors, whole = [], PoseErrors()
    for index, query in enumerate(arena.queries):
        frame = any_frame(np.random.default_rng([seed, index]))
        moved = written_in(frame, query)
        fragments = [fragment_of_arrays(moved, place, verifier.config) for place in range(query.n_places)]
        similarity = similarity_matrix(embed_graph(model, query), database)
        said, said_abroad = np.zeros(len(fragments)), np.zeros(len(fragments))
        places: list[Placed | None] = []
        best = reranked(verifier, fragments, similarity, chances=said, places=places)
        if len(arena.queries) > 1:
            reranked(verifier, fragments, similarity, building != index, said_abroad)
        right.append(arena.right(best, index, query.place_positions, radius_m))
        errors.append(PoseErrors())
        for q in np.flatnonzero(right[-1][:, 0]).tolist():
            for tally in (errors[-1], whole):
                add_error(tally, places[q], fragments[q], query.place_positions[q], -frame.yaw)
        sure.append(said)
        abroad.append(said_abroad)
    name, rng = f"{method} + layout", np.random.default_rng(seed)
    every = np.concatenate(right)
    of_building = np.repeat(np.arange(len(right)), [len(found) for found in right]).astype(np.int64)
    rows = [_row(name, "all", every, rng, of_building if len(right) > 1 else None)]
    rows += [_row(name, query.name, found, rng, None) for query, found in zip(arena.queries, right, strict=True)]
    rows = _with_chance(rows, arena, radius_m)
    for row, said, found in zip(rows, [np.concatenate(sure), *sure], [every, *right], strict=True):
        row["ece"] = expected_calibration_error(said, found[:, 0])
    for row, tally in zip(rows, [whole, *errors], strict=True):
        row |= tally.figures()
    if len(arena.queries) > 1:
        accepted = accepted_share(np.concatenate(sure), np.concatenate(abroad), every[:, 0])
        rows.append({"method": name, "scope": "foreign", "queries": len(every), **accepted})
    return rows


def _with_chance(rows: list[Row], arena: Arena, radius_m: float) -> list[Row]:
    """The rows of all buildings and of each, with the share of places that are right."""
    each = [arena.chance(building, radius_m) for building in range(len(arena.queries))]
    for row, of in zip(rows, [np.concatenate(each), *each], strict=True):
        row["chance"] = float(of.mean()) if len(of) else float("nan")
    return rows


def _row(method: str, scope: str, right: NDArray[np.bool_], rng: np.random.Generator, groups: Ints | None) -> Row:
    """Figures of the queries (Q, 10), whose matches are right or not."""
    row: Row = {"method": method, "scope": scope, "queries": len(right)}
    return row | metrics.success_figures(right, rng, groups)
