"""What is written of a building: its row, its places, its scene graph, its history. Inside the caller's transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence

from semloc_core.errors import MapError
from semloc_core.graph import SceneGraph
from semloc_core.map_database.loaded import StoredBuilding
from semloc_core.map_database.stored.records import Note, PlaceRows, check_name, pack_graph


def stored_building(
    name: str, graph: SceneGraph, place_ids: Sequence[str], note: Note, history: bytes = b""
) -> StoredBuilding:
    """A building ready to be stored, besides its places.

    Args:
        name: of the building.
        graph: its scene graph.
        place_ids: places of it.
        note: what is said of it.
        history: packed.

    Raises:
        MapError: a place that the scene graph lacks, a note that can't be stored.

    """
    source, frame_id, stamp_ns = note.get("source", ""), note.get("frame_id", "map"), note.get("stamp_ns")
    check_name("a frame", frame_id)
    if source:
        check_name("a source", source)
    if stamp_ns is not None and not -(2**63) <= stamp_ns < 2**63:
        raise MapError(f"expected a signed 64-bit stamp (got {stamp_ns})")
    packed = pack_graph(graph, frame_id)
    check_in_graph(graph, place_ids)
    return StoredBuilding(name, source, frame_id, stamp_ns, len(place_ids), packed, history)


def insert_building(connection: sqlite3.Connection, building: StoredBuilding, places: PlaceRows) -> None:
    """Write a building that the map does not have."""
    cursor = connection.execute(
        "INSERT INTO building (name, source, frame_id, stamp_ns, graph_digest, graph_bytes, graph) "
        "VALUES (?, ?, ?, ?, ?, ?, ?)",
        (
            building.name,
            building.source,
            building.frame_id,
            building.stamp_ns,
            building.graph.digest,
            building.graph.size,
            building.graph.data,
        ),
    )
    assert cursor.lastrowid is not None
    insert = "INSERT INTO place (building, id, x, y, z, embedding) VALUES (?, ?, ?, ?, ?, ?)"
    connection.executemany(insert, places.rows(cursor.lastrowid))
    if building.history:
        connection.execute("INSERT INTO history (building, data) VALUES (?, ?)", (cursor.lastrowid, building.history))


def delete_building(connection: sqlite3.Connection, key: int) -> None:
    """Delete a building's rows."""
    for table in ("history", "storeys", "place"):
        connection.execute(f"DELETE FROM {table} WHERE building = ?", (key,))
    connection.execute("DELETE FROM building WHERE id = ?", (key,))


def check_in_graph(graph: SceneGraph, place_ids: Sequence[str]) -> None:
    """Refuse places that a scene graph does not have."""
    for id_ in place_ids:
        if id_ not in graph.places:
            raise MapError(f"expected places of the building's scene graph (got {id_!r}, which it does not have)")
