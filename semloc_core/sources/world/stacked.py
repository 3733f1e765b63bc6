"""Buildings of several storeys, alike in a tower or each of its own, joined by stairs; and flats of one plan."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import msgspec
import numpy as np

from semloc_core.graph import SceneGraph
from semloc_core.sources.hydra.write import Room, node_id
from semloc_core.sources.world.kinds import BuildingKind, draw
from semloc_core.sources.world.office import World, furnished, laid_out
from semloc_core.sources.world.second_run import SecondRun, detect
from semloc_core.wire import Object, Place, Position

STEPS = 5
"""Places on a flight of stairs."""
FLIGHT_M = 2.0
"""How far a flight leads in the plane."""
LACKS = 0.2
"""Share of a plan's furniture that one of many flats lacks."""


def draw_stacked(
    kind: BuildingKind,
    storeys: int,
    rng: np.random.Generator,
    *,
    alike: bool = False,
    changed: float = 0.0,
    run: SecondRun | None = None,
) -> tuple[World, World]:
    """A building of several storeys as mapped, and as a detector saw it on another run.

    Args:
        kind: of its storeys.
        storeys: how many.
        rng: the only source of randomness.
        alike: every storey has the rooms and the furniture of the first, but for places, which are each one's own.
        changed: share of the objects that each further storey of a tower lacks.
        run: how the detector errs; None for the defaults.

    Raises:
        ConfigError: none that was drawn could be furnished.

    """
    rise = float(rng.uniform(2.5, 3.6))
    floors = [
        draw(kind, rng, lambda config, rng: (config, *furnished(config, rng))) for _ in range(1 if alike else storeys)
    ]
    mapped, seen = [], []
    for k in range(storeys):
        config, plan, items = floors[0 if alike else k]
        if alike and k:
            kept = rng.random(len(items)) >= changed
            items = [item for item, stays in zip(items, kept.tolist(), strict=True) if stays] or items
        mapped.append(laid_out(config, plan, items, items, rng))
        seen.append(laid_out(config, plan, items, detect(plan, items, run or SecondRun(), rng), rng))
    stairs = []
    for _ in range(storeys - 1):
        places = list(mapped[0].graph.places.values())
        x, y, _ = places[int(rng.integers(len(places)))]
        stairs.append((x, y))
    return stack(mapped, stairs, rise), stack(seen, stairs, rise)


def draw_flat(
    kind: BuildingKind, plan: np.random.Generator, rng: np.random.Generator, lacks: float = LACKS
) -> tuple[World, World]:
    """One of many flats of the same plan and furniture, each in a frame of its own, as mapped and as seen again.

    Args:
        kind: of building.
        plan: draws the rooms and the furniture: from the same state the same ones.
        rng: draws what is this flat's own: what it lacks, its places, what the detector makes of it.
        lacks: share of the furniture that it lacks.

    Raises:
        ConfigError: as of `draw_pair`.

    """
    config, rooms, items = draw(kind, plan, lambda config, rng: (config, *furnished(config, rng)))
    kept = rng.random(len(items)) >= lacks
    items = [item for item, stays in zip(items, kept.tolist(), strict=True) if stays] or items
    seen = detect(rooms, items, SecondRun(), rng)
    return laid_out(config, rooms, items, items, rng), laid_out(config, rooms, items, seen, rng)


def stack(floors: Sequence[World], stairs: Sequence[tuple[float, float]], rise_m: float) -> World:
    """Floors one above the other as one building.

    Args:
        floors: from the lowest up, of one labelspace.
        stairs: for each but the last where, in the plane, a flight leads up from it (m).
        rise_m: from floor to floor.

    """
    places: list[Place] = []
    objects: list[Object] = []
    edges: list[tuple[str, str]] = []
    rooms: dict[str, Room] = {}
    number: list[dict[str, str]] = []
    for k, floor in enumerate(floors):
        up, graph = k * rise_m, floor.graph
        ids = {id_: node_id("p", len(places) + i) for i, id_ in enumerate(sorted(graph.places))}
        ids |= {id_: node_id("O", len(objects) + i) for i, id_ in enumerate(sorted(graph.objects))}
        number.append(ids)
        places += [Place(ids[id_], _raised(graph.places[id_], up)) for id_ in sorted(graph.places)]
        objects += [
            msgspec.structs.replace(o, id=ids[o.id], position=_raised(o.position, up))
            for o in (graph.objects[id_] for id_ in sorted(graph.objects))
        ]
        edges += sorted((ids[a], ids[b]) for a, row in graph.neighbours.items() for b in row if a < b)
        edges += sorted((ids[p], ids[o]) for o, parents in graph.parents.items() for p in parents)
        for room in floor.rooms.values():
            own = tuple(ids[place] for place in room.places)
            rooms[node_id("R", len(rooms))] = Room(f"{room.name}, {k}", _raised(room.position, up), own)
    for k, (x, y) in enumerate(stairs):
        foot, head = (_nearest(floors[k + i], (x + i * FLIGHT_M, y)) for i in (0, 1))
        low = np.array(_raised(floors[k].graph.places[foot], k * rise_m))
        high = np.array(_raised(floors[k + 1].graph.places[head], (k + 1) * rise_m))
        way = [number[k][foot]]
        for step in range(1, STEPS + 1):
            at = low + (high - low) * step / (STEPS + 1)
            way.append(node_id("p", len(places)))
            places.append(Place(way[-1], (float(at[0]), float(at[1]), float(at[2]))))
        way.append(number[k + 1][head])
        edges += list(pairwise(way))
    return World(SceneGraph.of(places, objects, edges), rooms, floors[0].labelspace)


def _raised(position: Position, up: float) -> Position:
    x, y, z = position
    return (x, y, z + up)


def _nearest(floor: World, at: tuple[float, float]) -> str:
    places = floor.graph.places
    return min(places, key=lambda id_: (np.hypot(places[id_][0] - at[0], places[id_][1] - at[1]), id_))
