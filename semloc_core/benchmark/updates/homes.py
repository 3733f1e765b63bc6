"""Maps of homes, generated or real, with runs through some of them as a detector saw them another day."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from semloc_core import wire
from semloc_core.encoding import Model, general_model
from semloc_core.evaluate import draw_buildings, make_arena, mapped_building, read_buildings, read_distractors
from semloc_core.graph import GraphArrays, Labelspace, union
from semloc_core.map_database import LoadedMap, PlaceRows, StoredBuilding, assemble
from semloc_core.metrics import Progress, no_progress
from semloc_core.sources import KINDS, SimulationConfig, simulate_traversal
from semloc_core.text import short_repr
from semloc_core.training import PerturbConfig, perturb

DRAWN = 200
"""Homes drawn, a third of a second each. Those beyond them are these once more, furnished otherwise (`OTHERWISE`)."""
OTHERWISE = PerturbConfig(mobility_scale=0.0, jitter_m=0.5, drop_probability=0.2, mislabel_probability=0.1)
RUNS, DISTANCE_M = 3, 40.0
SEED_OF_RUNS = 1


@short_repr
@dataclass(frozen=True, eq=False)
class Homes:
    """Homes, and runs through the first of them.

    Args:
        scope: what they are called.
        model: the general encoder, fitted to the first of them.
        arrays: each home, as mapped.
        buildings: each as a map has it, by rising name.
        runs: updates as JSON text through the first homes, the first of each a full one.

    """

    scope: str
    model: Model
    arrays: Sequence[GraphArrays]
    buildings: Sequence[tuple[StoredBuilding, PlaceRows]]
    runs: Sequence[Sequence[bytes]]

    def first(self, number: int) -> Homes:
        """The same with so many of the homes."""
        runs = self.runs[: min(len(self.runs), number)]
        return replace(self, arrays=self.arrays[:number], buildings=self.buildings[:number], runs=runs)

    def loaded(self) -> LoadedMap:
        """A map of them in memory."""
        return assemble("homes", self.model, self.buildings)


def generated_homes(
    number: int, seed: int, distance_m: float = DISTANCE_M, drawn: int = DRAWN, progress: Progress = no_progress
) -> Homes:
    """Homes of COCO's classes.

    Args:
        number: how many.
        seed: of all that is drawn.
        distance_m: how far each run goes.
        drawn: how many differ in their plan.
        progress: told of every home.

    """
    rng = np.random.default_rng(seed)
    progress(0, number, f"drawing {min(number, drawn)} homes")
    plans, again, space = draw_buildings(KINDS["home"], min(number, drawn), rng)

    def homes() -> Iterator[GraphArrays]:
        for i in range(number):
            progress(i, number, "homes into a map")
            yield plans[i] if i < len(plans) else perturb(plans[i % len(plans)], space, OTHERWISE, rng)

    return _homes("generated homes", homes(), general_model(plans, space), again[:RUNS], seed, distance_m)


def real_homes(
    folders: Sequence[Path], seed: int, distance_m: float = DISTANCE_M, progress: Progress = no_progress
) -> Homes:
    """Buildings as files have them.

    Args:
        folders: the first holds a folder a building, each with map.json and query.json; the others
            (`semloc_core.evaluate.read_distractors`) are only in the map.
        seed: of the runs.
        distance_m: how far each goes.
        progress: told of every building.

    Raises:
        FileFormatError: no building in a folder, or a file that can't be read.

    """
    buildings, others = read_buildings(folders[0]), read_distractors(folders[1:])
    files = [file for building in buildings for file in (building.map, building.query)]
    space = union([file.labelspace for file in (*files, *others)])
    arena = make_arena(buildings, space, others)

    def homes() -> Iterator[GraphArrays]:
        for i, graph in enumerate(arena.maps):
            progress(i, len(arena.maps), "homes into a map")
            yield graph

    scope = " + ".join(folder.resolve().name for folder in folders)
    return _homes(scope, homes(), general_model(arena.maps, space), arena.queries[:RUNS], seed, distance_m)


def _homes(
    scope: str, homes: Iterator[GraphArrays], model: Model, queries: Sequence[GraphArrays], seed: int, distance_m: float
) -> Homes:
    space, arrays, buildings = model.labelspace, [], []
    for i, home in enumerate(homes):
        arrays.append(home)
        buildings.append(mapped_building(f"home {i:05d}", home, model))
    walk = SimulationConfig(distance_m=distance_m)
    runs = [_run(graph, space, walk, np.random.default_rng([seed, SEED_OF_RUNS, i])) for i, graph in enumerate(queries)]
    return Homes(scope, model, arrays, buildings, runs)


def _run(graph: GraphArrays, space: Labelspace, walk: SimulationConfig, rng: np.random.Generator) -> list[bytes]:
    return [wire.encode(step.update) for step in simulate_traversal(graph.to_scene_graph(space), walk, rng)]
