"""A `SceneGraph` as a Hydra scene-graph file (spark_dsg JSON 1.1): what generated worlds are kept in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from semloc_core.errors import FileFormatError
from semloc_core.files import write_whole
from semloc_core.graph import INDEX_BITS, Labelspace, SceneGraph, node_number
from semloc_core.sources.hydra.format import OBJECT_LABELSPACE
from semloc_core.text import short_repr
from semloc_core.wire import Object, Position

OBJECTS, PLACES, ROOMS, BUILDINGS = 2, 3, 4, 5
UNLABELLED = 2**32 - 1
IDENTITY = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
BLACK = {"a": 255, "b": 0, "g": 0, "r": 0}
LARGEST_INDEX = (1 << INDEX_BITS) - 1


@short_repr
@dataclass(frozen=True)
class Room:
    """A room: its name, its centre (m), and the ids of its places."""

    name: str
    position: Position
    places: tuple[str, ...]


def node_id(prefix: str, index: int) -> str:
    """Hydra's 64-bit node id as a decimal string: the prefix's character code in the top byte.

    Args:
        prefix: one ASCII character; ``p`` place, ``O`` object, ``R`` room.
        index: counts from 0.

    """
    if not (len(prefix) == 1 and prefix.isascii() and 0 <= index <= LARGEST_INDEX):
        raise ValueError(f"expected one ASCII character and an index of 56 bits (got {prefix!r}, {index})")
    return str(node_number(prefix, index))


def write_hydra(
    path: str | Path, graph: SceneGraph, labelspace: Labelspace, rooms: Mapping[str, Room] | None = None
) -> None:
    """Write a scene graph; what `semloc_core.sources.hydra.read_hydra` reads back is equal.

    Args:
        path: the file.
        graph: node ids are decimal 64-bit numbers (see `node_id`); it has no explicit sightings, for which the
            format has no room.
        labelspace: gives classes their integer labels; those without get free ones. The names go into the file.
        rooms: node id -> room.

    Raises:
        FileFormatError: another id, sightings, a room's place that is unknown, or the file can't be written.

    """
    if graph.sightings:
        raise FileFormatError(f"expected a graph without sightings for {path} (got {len(graph.sightings)} objects)")
    rooms = rooms or {}
    label = _labels(graph, labelspace)
    names = {i: c for c, numbers in labelspace.ids.items() for i in numbers} | {i: c for c, i in label.items()}
    nodes = [
        *(_node(PLACES, p, graph.places[p], _place_attributes(p)) for p in _sorted(graph.places, path)),
        *(
            _node(OBJECTS, o, graph.objects[o].position, _object_attributes(graph.objects[o], label))
            for o in _sorted(graph.objects, path)
        ),
        *(_node(ROOMS, r, rooms[r].position, _room_attributes(rooms[r])) for r in _sorted(rooms, path)),
    ]
    edges = [
        *((int(a), int(b)) for a, row in graph.neighbours.items() for b in row if int(a) < int(b)),
        *((int(p), int(o)) for p, objects in graph.children.items() for o in objects),
        *((int(r), int(p)) for r, room in rooms.items() for p in _known(room, graph, path)),
    ]
    layers = [{"layer": layer, "partition": 0} for layer in (OBJECTS, PLACES, ROOMS, BUILDINGS)]
    document = {
        "SPARK_DSG_header": {"project_name": "main", "version": {"major": 1, "minor": 1, "patch": 3}},
        "directed": False,
        "edges": [_edge(a, b) for a, b in sorted(edges)],
        "layer_keys": layers,
        "layer_names": dict(zip(("OBJECTS", "PLACES", "ROOMS", "BUILDINGS"), layers, strict=True), AGENTS=layers[0]),
        "metadata": {"labelspaces": {OBJECT_LABELSPACE: sorted(names.items())}},
        "multigraph": False,
        "nodes": nodes,
    }
    try:
        write_whole(path, msgspec.json.encode(document))
    except OSError as error:
        raise FileFormatError(f"expected to write a Hydra file at {path} (got: {error.strerror})") from error


def _labels(graph: SceneGraph, labelspace: Labelspace) -> dict[str, int]:
    """Class name -> label, of the labelspace's classes and of all others that occur."""
    taken = {number for numbers in labelspace.ids.values() for number in numbers}
    free = (i for i in range(UNLABELLED) if i not in taken)
    others = sorted({thing.class_ for thing in graph.objects.values()} - set(labelspace.classes))
    return {c: numbers[0] if (numbers := labelspace.ids.get(c)) else next(free) for c in (*labelspace.classes, *others)}


def _sorted(ids: Mapping[str, Any], path: str | Path) -> list[str]:
    for i in ids:
        if not (i.isascii() and i.isdigit() and int(i) < 2**64 and str(int(i)) == i):
            raise FileFormatError(f"expected node ids that are decimal 64-bit numbers, for {path} (got {i!r})")
    return sorted(ids, key=int)


def _known(room: Room, graph: SceneGraph, path: str | Path) -> tuple[str, ...]:
    for place in room.places:
        if place not in graph.places:
            raise FileFormatError(f"expected the rooms' places to be the graph's, for {path} (got {place!r})")
    return room.places


def _node(layer: int, node: str, position: Position, attributes: dict[str, Any]) -> dict[str, Any]:
    shared = {
        "bounding_box": _box(None, position),
        "color": BLACK,
        "is_active": False,
        "is_predicted": False,
        "last_update_time_ns": 0,
        "metadata": {},
        "position": position,
        "semantic_feature": {"cols": 0, "data": None, "rows": 0},
        "semantic_label": UNLABELLED,
    }
    return {"attributes": shared | attributes, "id": int(node), "layer": layer, "partition": 0}


def _place_attributes(node: str) -> dict[str, Any]:
    number = int(node)
    return {
        "active_frontier": False,
        "anti_frontier": False,
        "deformation_connections": [],
        "distance": 0.0,
        "frontier_scale": [0.0, 0.0, 0.0],
        "mesh_vertex_labels": [],
        "name": f"p({number & LARGEST_INDEX})",
        "need_cleanup": False,
        "num_basis_points": 0,
        "num_frontier_voxels": 0,
        "orientation": IDENTITY,
        "pcl_mesh_connections": [],
        "real_place": True,
        "type": "PlaceNodeAttributes",
        "voxblox_mesh_connections": [],
    }


def _object_attributes(thing: Object, label: Mapping[str, int]) -> dict[str, Any]:
    return {
        "bounding_box": _box(thing.size, thing.position),
        "mesh_connections": [],
        "name": thing.class_,
        "registered": False,
        "semantic_label": label[thing.class_],
        "type": "ObjectNodeAttributes",
        "world_R_object": IDENTITY,
    }


def _room_attributes(room: Room) -> dict[str, Any]:
    return {"name": room.name, "semantic_class_probabilities": {}, "type": "RoomNodeAttributes"}


def _box(size: Position | None, centre: Position) -> dict[str, Any]:
    return {
        "dimensions": size if size is not None else (0.0, 0.0, 0.0),
        "type": "AABB" if size is not None else "INVALID",
        "world_P_center": centre,
        "world_R_center": IDENTITY,
    }


def _edge(source: int, target: int) -> dict[str, Any]:
    info = {"metadata": {}, "type": "EdgeAttributes", "weight": 1.0, "weighted": False}
    return {"info": info, "source": source, "target": target}
