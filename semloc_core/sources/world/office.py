"""A parametric office with the object counts of the paper's Table I: a stand-in where its data set is not at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from semloc_core.graph import Labelspace, SceneGraph, load_labelspace
from semloc_core.sources.hydra.write import Room, node_id, write_hydra
from semloc_core.sources.world.floor_plan import CORRIDOR, FloorPlan, RoomKind, corridor_plan
from semloc_core.sources.world.furniture import Furniture, Item, furnish
from semloc_core.sources.world.places import Floats, Ints, largest_component, sample_places, traversability
from semloc_core.sources.world.second_run import SecondRun, detect
from semloc_core.text import short_repr
from semloc_core.wire import Object, Place

OFFICE_ROOMS = (
    RoomKind("open plan", 3, (12.2, 17.4), door_m=3.0),
    RoomKind("lounge", 1, (10.2, 14.6), door_m=3.0),
    RoomKind("office", 4, (3.6, 4.8)),
    RoomKind("kitchen", 1, (4.5, 6.0)),
)

# Counts: the paper's Table I. A computer's footprint is its desk's.
OFFICE_FURNITURE = (
    Furniture(
        "computer",
        35,
        "wall",
        (0.5, 0.4, 0.45),
        0.95,
        rooms=("office", "open plan"),
        per_room=(12, 14),
        group_m=6.0,
        footprint=(1.4, 0.75),
    ),
    Furniture(
        "couch",
        11,
        "wall",
        (1.9, 0.9, 0.8),
        0.4,
        rooms=("lounge", "kitchen", "open plan"),
        per_room=(5, 6),
        group_m=6.0,
    ),
    Furniture("chair", 28, "beside", (0.6, 0.6, 0.95), 0.48, beside="computer"),
    Furniture(
        "plant",
        13,
        "wall",
        (0.5, 0.5, 1.2),
        0.6,
        rooms=("lounge", "open plan", CORRIDOR),
        per_room=(5, 6),
        group_m=6.0,
    ),
    Furniture("painting", 8, "wall", (1.0, 0.05, 0.8), 1.6, rooms=(CORRIDOR, "lounge")),
    Furniture("trash can", 8, "beside", (0.3, 0.3, 0.4), 0.2, beside="computer"),
    Furniture("trash can", 7, "door", (0.3, 0.3, 0.4), 0.2, rooms=("kitchen", "lounge", "open plan", CORRIDOR)),
)


class OfficeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What to build; by default an office as hard as the paper's, for bag of words.

    How hard that is, ``tests/evaluate/paper/test_difficulty.py`` measures.

    ``rooms`` and ``furniture``: what there is; ``wings``: number of corridors; ``depth_m``, ``corridor_m``: depth of
    rooms and width of corridors; ``passages``, ``passage_m``: share of neighbouring rooms that an opening joins, and
    how wide it is; ``darts_per_m2``: places thrown, of which those are kept that keep a distance between the bounds
    ``spacing_m`` from others; ``max_edge_m``: longest traversability edge; ``place_height_m``,
    ``place_height_std_m``: places float at this height, give or take; ``labelspace``: name or path of the one
    that has the furniture's classes. Metres.
    """

    rooms: tuple[RoomKind, ...] = OFFICE_ROOMS
    furniture: tuple[Furniture, ...] = OFFICE_FURNITURE
    wings: int = 1
    depth_m: float = 6.3
    corridor_m: float = 3.0
    passages: float = 0.0
    passage_m: float = 2.5
    darts_per_m2: float = 24.0
    spacing_m: tuple[float, float] = (0.4, 0.65)
    max_edge_m: float = 1.6
    place_height_m: float = 1.2
    place_height_std_m: float = 0.12
    labelspace: str = "uhumans2_office"


@short_repr
@dataclass(frozen=True, eq=False)
class World:
    """A generated building.

    Args:
        graph: places, objects, edges (one object–place edge an object: its nearest place in the room).
        rooms: node id -> room; a doorway's places belong to one of its two rooms.
        labelspace: classes of the objects.

    """

    graph: SceneGraph
    rooms: dict[str, Room]
    labelspace: Labelspace


def make_office(config: OfficeConfig, rng: np.random.Generator) -> World:
    """Build a world: rooms along corridors, furniture in groups, places in the free space.

    Places are thrown at random into free space as irregularly as Hydra's, joined only through free space and doors;
    those that can't be reached are left out. The same configuration and generator state give the same world.

    Args:
        config: what to build.
        rng: the only source of randomness.

    Raises:
        ConfigError: the furniture does not fit.

    """
    plan, items = furnished(config, rng)
    return laid_out(config, plan, items, items, rng)


def make_world_pair(
    config: OfficeConfig, rng: np.random.Generator, run: SecondRun | None = None
) -> tuple[World, World]:
    """Build a world, and the same building as a detector saw it on another run: its places are its own.

    Args:
        config: what to build.
        rng: the only source of randomness.
        run: what the detector misses and invents; None for the defaults.

    Raises:
        ConfigError: the furniture does not fit.

    """
    plan, items = furnished(config, rng)
    mapped = laid_out(config, plan, items, items, rng)
    return mapped, laid_out(config, plan, items, detect(plan, items, run or SecondRun(), rng), rng)


def furnished(config: OfficeConfig, rng: np.random.Generator) -> tuple[FloorPlan, list[Item]]:
    """A floor plan and what stands on it; ConfigError where that does not fit."""
    plan = corridor_plan(
        config.rooms,
        rng,
        wings=config.wings,
        depth_m=config.depth_m,
        corridor_m=config.corridor_m,
        passages=config.passages,
        passage_m=config.passage_m,
    )
    return plan, furnish(plan, config.furniture, rng)


def laid_out(
    config: OfficeConfig, plan: FloorPlan, items: Sequence[Item], seen: Sequence[Item], rng: np.random.Generator
) -> World:
    """Places between what stands there (``items``), objects as they were seen."""
    labelspace = load_labelspace(config.labelspace)
    points, rooms = sample_places(plan, items, config.darts_per_m2, config.spacing_m, rng)
    edges = traversability(plan, items, points, rooms, config.max_edge_m)
    kept = largest_component(len(points), edges)
    new_index = np.cumsum(kept) - 1
    edges = new_index[edges[:, kept[edges].all(axis=0)]]
    points, rooms = points[kept], rooms[kept]
    heights = rng.normal(config.place_height_m, config.place_height_std_m, size=len(points))

    place_ids = [node_id("p", i) for i in range(len(points))]
    owner = np.array([r if r >= 0 else plan.doors[-1 - r].rooms[0] for r in rooms], dtype=np.int64)
    graph = SceneGraph.of(
        [
            Place(place_id, (float(x), float(y), float(z)))
            for place_id, (x, y), z in zip(place_ids, points, heights, strict=True)
        ],
        [Object(node_id("O", i), item.class_, item.position, item.size) for i, item in enumerate(seen)],
        [(place_ids[a], place_ids[b]) for a, b in edges.T]
        + [(place_ids[_parent(item, plan, points, rooms)], node_id("O", i)) for i, item in enumerate(seen)],
    )
    return World(graph, _rooms(plan, owner, place_ids, config.place_height_m), labelspace)


def write_world(path: str | Path, world: World) -> None:
    """Write a world as a Hydra v1.1 file, rooms and all.

    Raises:
        FileFormatError: the file can't be written.

    """
    write_hydra(path, world.graph, world.labelspace, world.rooms)


def _rooms(plan: FloorPlan, owner: Ints, place_ids: Sequence[str], height_m: float) -> dict[str, Room]:
    rooms = {}
    for r, room in enumerate(plan.rooms):
        x, y = ((low + high) / 2 for low, high in zip(room.low, room.high, strict=True))
        places = tuple(place_ids[int(i)] for i in np.flatnonzero(owner == r))
        rooms[node_id("R", r)] = Room(room.name, (x, y, height_m), places)
    return rooms


def _parent(item: Item, plan: FloorPlan, points: Floats, rooms: Ints) -> int:
    """The nearest place of the item's room or one of its doors (the nearest of all where it has none)."""
    doors = [-1 - d for d, door in enumerate(plan.doors) if item.room in door.rooms]
    here = np.flatnonzero(np.isin(rooms, [item.room, *doors]))
    here = here if len(here) else np.arange(len(points))
    return int(here[np.argmin(np.linalg.norm(points[here] - item.position[:2], axis=1))])
