"""What a person wants to know of a map before trusting a robot to it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from semloc_core.encoding import Model
from semloc_core.graph import Labelspace, read_graph
from semloc_core.map_database.history import move_rates, unpack_history
from semloc_core.map_database.loaded import StoredBuilding, read_map
from semloc_core.map_database.protocols import ReadableMap
from semloc_core.map_database.stored.meta import MapMeta, read_meta
from semloc_core.map_database.stored.records import PlaceRows, derived_storeys, unpack_graph
from semloc_core.map_database.stored.schema import format_version, read


def describe(path: str | Path) -> dict[str, Any]:
    """What is in a map, as ``semloc map info`` prints it: plain values that go into JSON.

    Raises:
        MapError: not a map, damaged, or of another format.

    """
    path = Path(path)
    version, meta, loaded = read(
        path, lambda connection: (format_version(connection), read_meta(connection), read_map(connection, path.stem))
    )
    said = describe_map(loaded, meta, loaded.model)
    first = {"name": said["name"], "hash": said["hash"], "format_version": version, "bytes": path.stat().st_size}
    return first | said


def describe_map(map_: ReadableMap, meta: MapMeta, model: Model) -> dict[str, Any]:
    """What a map says of itself, wherever it is kept, and of its buildings; each is read, so each is checked."""
    buildings = [_building(*map_.building(name), model.labelspace) for name in map_.buildings]
    return {
        "name": map_.name,
        "hash": meta.content_hash,
        "generation": meta.generation,
        "places": sum(building["places"] for building in buildings),
        "dimension": meta.dimension,
        "model": {
            "name": meta.model_name,
            "hash": meta.model_hash,
            "config": msgspec.to_builtins(model.encoder.config),
        },
        "labelspace": {
            "name": meta.labelspace_name,
            "hash": meta.labelspace_hash,
            "classes": len(model.labelspace),
        },
        "buildings": buildings,
    }


def _building(stored: StoredBuilding, places: PlaceRows, space: Labelspace) -> dict[str, Any]:
    """What is known of one building; of its storeys, from the lowest up, how many places at what median height.

    ``extent_m``: of its places, in its frame: [x, y, z] from, [x, y, z] to; null where it has none.
    """
    history, graph = unpack_history(stored.history), read_graph(unpack_graph(stored.graph), space)
    classes = Counter(item.class_ for item in graph.objects.values())
    on = np.array(stored.storeys if stored.storeys is not None else derived_storeys(stored.graph, places.ids))
    at = places.positions
    return {
        "name": stored.name,
        "source": stored.source,
        "frame_id": stored.frame_id,
        "stamp_ns": stored.stamp_ns,
        "places": stored.n_places,
        "objects": len(graph.objects),
        "extent_m": np.round([at.min(axis=0), at.max(axis=0)], 2).tolist() if len(at) else None,
        "traversals": len(history.traversals),
        "moved": move_rates([history.classes], history.classes),
        "classes": dict(sorted(classes.items(), key=lambda item: (-item[1], item[0]))),
        "storeys": [
            {"places": int((on == k).sum()), "height_m": round(float(np.median(at[on == k, 2])), 2)}
            for k in np.unique(on).tolist()
        ],
    }
