"""What a person wants to know of a map on a server."""

from __future__ import annotations

from typing import Any

import numpy as np

from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.graph import read_graph, storeys_of
from semloc_core.map_database import describe_building, describe_meta, describe_storeys


def describe_server_map(database: FleetDatabase) -> dict[str, Any]:
    """As `semloc_core.map_database.describe`, of a map on a server; each building is fetched, so each is checked.

    Raises:
        MapError: a damaged map, no server.

    """
    meta = database.meta
    space, buildings = database.model.labelspace, []
    for name in database.buildings:
        (stored, places), graph = database.building(name), database.graph(name)
        on = storeys_of(graph)
        storeys = describe_storeys(np.array([on[id_] for id_ in places.ids]), places.positions[:, 2])
        buildings.append(describe_building(stored, read_graph(graph, space)) | {"storeys": storeys})
    return {"name": database.name, "hash": meta.content_hash, **describe_meta(meta, database.model, buildings)}
