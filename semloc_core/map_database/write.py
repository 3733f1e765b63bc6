"""What is written of a building: its row, its places, its scene graph, its history. Inside the caller's transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence

from semloc_core.errors import MapError
from semloc_core.map_database.history import History, pack_history
from semloc_core.map_database.records import Note, PlaceRows, check_name, pack_graph
from semloc_core.scene_graph import SceneGraph

INSERT_PLACE = "INSERT INTO place (building, id, x, y, z, embedding) VALUES (?, ?, ?, ?, ?, ?)"


def insert_building(
    connection: sqlite3.Connection, name: str, graph: SceneGraph, places: PlaceRows, note: Note
) -> None:
    """Write a building that the map does not have.

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
    check_in_graph(graph, places.ids)
    cursor = connection.execute(
        "INSERT INTO building (name, source, frame_id, stamp_ns, graph_digest, graph_bytes, graph) "
        "VALUES (?, ?, ?, ?, ?, ?, ?)",
        (name, source, frame_id, stamp_ns, packed.digest, packed.size, packed.data),
    )
    assert cursor.lastrowid is not None
    connection.executemany(INSERT_PLACE, places.rows(cursor.lastrowid))


def delete_building(connection: sqlite3.Connection, key: int) -> None:
    """Delete a building's rows."""
    connection.execute("DELETE FROM history WHERE building = ?", (key,))
    connection.execute("DELETE FROM place WHERE building = ?", (key,))
    connection.execute("DELETE FROM building WHERE id = ?", (key,))


def store_graph(connection: sqlite3.Connection, key: int, graph: SceneGraph) -> None:
    """Put another scene graph in place of a building's."""
    (frame_id,) = connection.execute("SELECT frame_id FROM building WHERE id = ?", (key,)).fetchone()
    packed = pack_graph(graph, frame_id)
    connection.execute(
        "UPDATE building SET digest = NULL, graph_digest = ?, graph_bytes = ?, graph = ? WHERE id = ?",
        (packed.digest, packed.size, packed.data, key),
    )


def store_history(connection: sqlite3.Connection, key: int, history: History) -> None:
    """Put another history in place of a building's."""
    connection.execute("DELETE FROM history WHERE building = ?", (key,))
    if data := pack_history(history):
        connection.execute("INSERT INTO history (building, data) VALUES (?, ?)", (key, data))
    connection.execute("UPDATE building SET digest = NULL WHERE id = ?", (key,))


def check_in_graph(graph: SceneGraph, place_ids: Sequence[str]) -> None:
    """Refuse places that a scene graph does not have."""
    for id_ in place_ids:
        if id_ not in graph.places:
            raise MapError(f"expected places of the building's scene graph (got {id_!r}, which it does not have)")
