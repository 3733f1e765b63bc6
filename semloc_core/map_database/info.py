"""What a person wants to know of a map file before trusting a robot to it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from semloc_core.map_database.history import move_rates
from semloc_core.map_database.loaded import read_map
from semloc_core.map_database.meta import read_meta
from semloc_core.map_database.schema import format_version, read


def describe(path: str | Path) -> dict[str, Any]:
    """What is in a map, as ``semloc map info`` prints it: plain values that go into JSON.

    Raises:
        MapError: not a map, damaged, or of another format.

    """
    path = Path(path)
    version, meta, loaded = read(
        path, lambda connection: (format_version(connection), read_meta(connection), read_map(connection, path.stem))
    )
    model = loaded.model
    buildings = []
    for stored in loaded.stored:
        graph, history = loaded.graph(stored.name), loaded.history(stored.name)
        classes = Counter(item.class_ for item in graph.objects.values())
        buildings.append(
            {
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
        )
    return {
        "name": loaded.name,
        "hash": loaded.hash,
        "format_version": version,
        "generation": meta.generation,
        "bytes": path.stat().st_size,
        "places": loaded.n_places,
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
