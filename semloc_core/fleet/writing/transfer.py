"""Buildings copied between a map file and a map on a server."""

from __future__ import annotations

from collections.abc import Sequence

from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.map_database import (
    LoadedMap,
    WritableMap,
    building_digest,
    matching_buildings,
)
from semloc_core.map_merge import embed_again, map_weights


def push(loaded: LoadedMap, database: FleetDatabase, patterns: Sequence[str] = ()) -> tuple[int, int]:
    """Put buildings of a map file into a map on a server, in place of those of the same names.

    Args:
        loaded: the file.
        database: the map on the server.
        patterns: which buildings; none: all.

    Returns:
        How many were written, and how many were there already.

    Raises:
        MapError: another model, a pattern that fits no building.

    """
    database.require(loaded.model.hash, loaded.model.labelspace.hash)
    names = matching_buildings(loaded.buildings, patterns)
    written = 0
    with database.transaction():
        before = map_weights(database, loaded.model)
        digests = database.digests
        for name in names:
            stored, places = loaded.building(name)
            if digests.get(name) != building_digest(places, stored.frame_id, stored.graph.digest, stored.history):
                database.copy_building(stored, places)
                written += 1
        if loaded.model.encoder.counts_objects:
            after = map_weights(database, loaded.model)
            # What a class weighs, it weighs in all buildings of a map.
            if database.buildings != names and after != before:
                embed_again(database, loaded.model, database.buildings)
            elif after != loaded.class_weights:
                embed_again(database, loaded.model, names)
    return written, len(names) - written


def pull(database: FleetDatabase, file: WritableMap, patterns: Sequence[str] = ()) -> int:
    """Put buildings of a map on a server into a map file without buildings, all as they were at one moment.

    Args:
        database: the map on the server.
        file: a map without buildings, of the same model.
        patterns: which buildings; none: all.

    Returns:
        How many.

    Raises:
        MapError: another model, a pattern that fits no building.

    """
    model = database.model
    file.require(model.hash, model.labelspace.hash)
    names = matching_buildings(database.buildings, patterns)
    with file.transaction():
        for name in names:
            file.copy_building(*database.building(name))
        if model.encoder.counts_objects and map_weights(file, model) != map_weights(database, model):
            embed_again(file, model, names)  # of a part of the map less is known of what moves
    return len(names)
