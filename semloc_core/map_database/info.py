"""What a person wants to know of a map before trusting a robot to it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model
from semloc_core.graph import SceneGraph
from semloc_core.map_database.history import move_rates, unpack_history
from semloc_core.map_database.loaded import LoadedMap, StoredBuilding, read_map
from semloc_core.map_database.stored.meta import MapMeta, read_meta
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
    buildings = [
        describe_building(stored, loaded.graph(stored.name)) | {"storeys": _stored_storeys(loaded, stored.name)}
        for stored in loaded.stored
    ]
    bytes_ = {"format_version": version, "bytes": path.stat().st_size}
    return {"name": loaded.name, "hash": loaded.hash, **bytes_, **describe_meta(meta, loaded.model, buildings)}


def describe_meta(meta: MapMeta, model: Model, buildings: list[dict[str, Any]]) -> dict[str, Any]:
    """What a map says of itself, wherever it is kept, and of its buildings."""
    return {
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


def _stored_storeys(loaded: LoadedMap, building: str) -> list[dict[str, Any]]:
    rows = loaded.rows_of(building)
    return describe_storeys(loaded.storeys[rows], loaded.positions[rows, 2])


def describe_storeys(on: NDArray[np.int64], height: NDArray[np.float64]) -> list[dict[str, Any]]:
    """The storeys that (P,) places are on, from the lowest up: how many are there, and at what height (median)."""
    return [
        {"places": int((on == k).sum()), "height_m": round(float(np.median(height[on == k])), 2)}
        for k in np.unique(on).tolist()
    ]


def describe_building(stored: StoredBuilding, graph: SceneGraph) -> dict[str, Any]:
    """What is known of one building."""
    history = unpack_history(stored.history)
    classes = Counter(item.class_ for item in graph.objects.values())
    return {
        "name": stored.name,
        "source": stored.source,
        "frame_id": stored.frame_id,
        "stamp_ns": stored.stamp_ns,
        "places": stored.n_places,
        "objects": len(graph.objects),
        "traversals": len(history.traversals),
        "moved": move_rates([history.classes], history.classes),
        "classes": dict(sorted(classes.items(), key=lambda item: (-item[1], item[0]))),
    }
