"""Buildings that live: mapped once, walked through again and again, and asked about at last.

Generated worlds, whose objects are carried about by the mobility of their class, and real homes, whose later
traversals are what a detector saw there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.evaluate.relocalise import make_arena, read_buildings
from semloc_core.graph import Floats, GraphArrays, Labelspace, SceneGraph, many_balls, nearest_parents, union
from semloc_core.map_merge import Transform
from semloc_core.sources import OfficeConfig, WalkConfig, make_office, walk
from semloc_core.text import short_repr
from semloc_core.training import PERTURBATIONS, PerturbConfig, perturb

# Fewer places than the paper's office has: what is asked here does not need them.
WORLD = OfficeConfig(darts_per_m2=8.0, spacing_m=(0.7, 1.0), max_edge_m=2.2)


MISSES = (0.5, 1.5)
"""Beta distribution of how often a detector misses an object: a quarter on average, few always, many hardly ever."""


class LifeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What happens between two traversals, and what a traversal sees."""

    traversals: Annotated[int, Meta(ge=1, le=100, description="traversals that are merged, one after the other")] = 3
    mobility_m: Annotated[
        float,
        Meta(gt=0.0, le=100.0, description="an object moves with probability 1 - exp(-its class's mobility / this), m"),
    ] = 1.0
    carried_m: Annotated[
        float, Meta(gt=0.0, le=1000.0, description="an object that moves is put by a place at most this far away, m")
    ] = 8.0
    distance_m: Annotated[
        float, Meta(ge=0.0, le=1e5, description="metres walked by a traversal that is merged; 0: all is seen")
    ] = 150.0
    range_m: Annotated[float, Meta(gt=0.0, le=1e3, description="what is seen from the way, m along the graph")] = 5.0


@short_repr
@dataclass(frozen=True, eq=False)
class Visit:
    """A traversal that is merged.

    Args:
        graph: in a frame of its own.
        truth: from that frame into the building's.

    """

    graph: SceneGraph
    truth: Transform


@short_repr
@dataclass(frozen=True, eq=False)
class Case:
    """One building.

    Args:
        name: its name.
        first: as it was mapped.
        visits: traversals that are merged, in order.
        queries: what is asked, by name: later traversals, seen whole, in the building's frame.
        moves: class -> share of its objects that moved from one traversal to the next; empty where nobody knows.

    """

    name: str
    first: GraphArrays
    visits: tuple[Visit, ...]
    queries: dict[str, GraphArrays]
    moves: dict[str, float]


def world_cases(n: int, seed: int, config: LifeConfig) -> tuple[Labelspace, list[Case]]:
    """Generated offices; each with a seed of its own.

    Objects move between all traversals, also from the last that is merged to the one that is asked. The detector misses
    a quarter of the objects, invents a tenth and mislabels a twentieth, and each traversal samples places of its own.
    Which objects are hard to see is the detector's own: one misses what it missed before more often than not. The one
    that maps is the one that merges; both it and another one are asked.
    """
    space, cases = None, []
    for number in range(n):
        world = make_office(WORLD, np.random.default_rng([seed, number]))
        space = world.labelspace
        rng = np.random.default_rng([seed, number, 1])
        graph = GraphArrays.from_scene_graph(world.graph, space, f"world {number}")
        shares = {name: 1 - math.exp(-space.mobility_of(name) / config.mobility_m) for name in space.classes}
        robot, another = (rng.beta(*MISSES, graph.n_objects) for _ in range(2))
        first = _detected(graph, space, robot, rng)
        visits = []
        for _ in range(config.traversals):
            graph = carry(graph, space, shares, config.carried_m, rng)
            visits.append(_visit(_detected(graph, space, robot, rng), space, config, rng))
        graph = carry(graph, space, shares, config.carried_m, rng)
        queries = {
            "same detector": _detected(graph, space, robot, rng),
            "another detector": _detected(graph, space, another, rng),
        }
        cases.append(Case(f"world {number}", first, tuple(visits), queries, shares))
    assert space is not None
    return space, cases


def _detected(graph: GraphArrays, space: Labelspace, misses: Floats, rng: np.random.Generator) -> GraphArrays:
    """What a detector sees that misses object i with probability ``misses[i]``."""
    noise = msgspec.structs.replace(PERTURBATIONS["detector"], mobility_scale=0.0, drop_probability=0.0)
    return perturb(graph.with_objects(rng.random(graph.n_objects) >= misses), space, noise, rng)


HOME_NOISE = PerturbConfig(
    mobility_scale=0.0, jitter_m=0.1, drop_probability=0.1, false_ratio=0.05, resample_probability=1.0
)
"""On top of what the detector did: another run of it sees a little more or less."""


def home_cases(root: Path, seed: int, config: LifeConfig) -> tuple[Labelspace, list[Case]]:
    """Real homes: ``map.json`` is mapped, variants of ``query.json`` are merged, another one is asked.

    Variants share what the detector always misses or takes for something else, as runs of one robot do. Asked too is a
    variant of ``map.json`` as the generic detector sees it, which does not share that.

    Raises:
        FileFormatError: as `read_buildings`.

    """
    buildings = read_buildings(root)
    space = union([file.labelspace for building in buildings for file in (building.map, building.query)])
    arena = make_arena(buildings, space)
    cases = []
    for number, (mapped, query) in enumerate(zip(arena.maps, arena.queries, strict=True)):
        rng = np.random.default_rng([seed, number])
        visits = [_visit(perturb(query, space, HOME_NOISE, rng), space, config, rng) for _ in range(config.traversals)]
        generic = msgspec.structs.replace(PERTURBATIONS["detector"], mobility_scale=0.0)
        queries = {
            "same detector": perturb(query, space, HOME_NOISE, rng),
            "another detector": perturb(mapped, space, generic, rng),
        }
        cases.append(Case(mapped.name, mapped, tuple(visits), queries, {}))
    return space, cases


def carry(
    graph: GraphArrays, space: Labelspace, shares: dict[str, float], carried_m: float, rng: np.random.Generator
) -> GraphArrays:
    """Another day: some objects stand elsewhere.

    Args:
        graph: the building.
        space: its classes.
        shares: class -> probability that an object of it is carried.
        carried_m: how far at most, metres along the graph.
        rng: source of randomness.

    """
    share = np.array([shares[name] for name in space.classes] + [0.0])[graph.object_classes]
    moved = np.flatnonzero(rng.random(graph.n_objects) < share)
    parent = np.full(graph.n_objects, -1, dtype=np.int64)
    parent[graph.object_parents[0]] = graph.object_parents[1]
    moved = moved[parent[moved] >= 0]
    by_source, near, _ = many_balls(graph.n_places, graph.place_edges, graph.edge_lengths(), parent[moved], carried_m)
    positions = graph.object_positions.copy()
    for i, thing in enumerate(moved.tolist()):
        place = int(rng.choice(near[by_source == i]))
        positions[thing, :2] = graph.place_positions[place, :2] + rng.normal(0.0, 0.3, 2)
    stays = ~np.isin(graph.object_parents[0], moved)
    parents = np.concatenate(
        [graph.object_parents[:, stays], nearest_parents(positions, graph.place_positions, moved)], axis=1
    )
    order = np.lexsort((parents[1], parents[0]))
    none = np.zeros((2, 0), dtype=np.int64)
    return replace(graph, object_positions=positions, object_parents=parents[:, order], sightings=none)


def _visit(graph: GraphArrays, space: Labelspace, config: LifeConfig, rng: np.random.Generator) -> Visit:
    """What a walk through it sees, in a frame that begins anywhere."""
    if config.distance_m > 0:
        path = walk(graph, WalkConfig(distance_m=config.distance_m, range_m=config.range_m), rng)
        graph = path.part(path.steps - 1)[0]
    yaw, (x, y, z) = float(rng.uniform(-math.pi, math.pi)), rng.uniform(-20.0, 20.0, 3).tolist()
    into = Transform(yaw, (x, y, z))
    moved = replace(
        graph, place_positions=into.apply(graph.place_positions), object_positions=into.apply(graph.object_positions)
    )
    back = Transform(-yaw, (0.0, 0.0, 0.0)).apply(-np.array([[x, y, z]]))[0]
    bx, by, bz = back.tolist()
    return Visit(moved.to_scene_graph(space), Transform(-yaw, (bx, by, bz)))


def misplaced_m(found: Transform, truth: Transform, points: Floats) -> float:
    """Root mean square distance between where two transforms put points (N, 3), metres."""
    return float(np.sqrt(((found.apply(points) - truth.apply(points)) ** 2).sum(axis=1).mean()))
