"""What a person wants to know of a map on a server."""

from __future__ import annotations

from typing import Any

from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.graph import read_graph
from semloc_core.map_database import describe_building, describe_meta


def describe_server_map(database: FleetDatabase) -> dict[str, Any]:
    """As `semloc_core.map_database.describe`, of a map on a server; each building is fetched, so each is checked.

    Raises:
        MapError: a damaged map, no server.

    """
    meta = database.meta
    space = database.model.labelspace
    buildings = [
        describe_building(database.building(name)[0], read_graph(database.graph(name), space))
        for name in database.buildings
    ]
    return {"name": database.name, "hash": meta.content_hash, **describe_meta(meta, database.model, buildings)}
