"""The map: one SQLite file that is all a robot needs. `load` to localise, `MapDatabase` to change it."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.map_database.asked import in_the_words_of, reading_for
    from semloc_core.map_database.building_patterns import matching_buildings, unknown_building
    from semloc_core.map_database.database import MapDatabase
    from semloc_core.map_database.frames import frame_of
    from semloc_core.map_database.history import (
        FIRST_SEEN,
        MAX_HISTORY_BYTES,
        Before,
        ClassChange,
        History,
        ObjectBelief,
        Traversal,
        move_rates,
        pack_history,
        unpack_history,
    )
    from semloc_core.map_database.info import describe, describe_map
    from semloc_core.map_database.loaded import LoadedMap, StoredBuilding, Whole, assemble, load
    from semloc_core.map_database.protocols import ReadableMap, WritableMap
    from semloc_core.map_database.search.exact import ExactSearch, kth_largest
    from semloc_core.map_database.search.inverted import InvertedSearch
    from semloc_core.map_database.stored.meta import MapMeta, check_hash, read_meta
    from semloc_core.map_database.stored.records import (
        MAX_BUILDINGS,
        MAX_GRAPH_BYTES,
        Note,
        PackedGraph,
        PlaceRows,
        building_digest,
        check_name,
        check_places,
        content_hash,
        pack_graph,
        unpack_graph,
    )
    from semloc_core.map_database.stored.schema import MAX_BLOB_BYTES, publish_map, read
    from semloc_core.map_database.stored.write import check_in_graph, stored_building
    from semloc_core.map_database.weights import class_weights, object_weights
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Before", "ClassChange", "ExactSearch", "FIRST_SEEN", "History", "InvertedSearch", "LoadedMap", "MAX_BLOB_BYTES",
    "MAX_BUILDINGS", "MAX_GRAPH_BYTES", "MAX_HISTORY_BYTES", "MapDatabase", "MapMeta", "Note", "ObjectBelief",
    "PackedGraph", "PlaceRows", "ReadableMap", "StoredBuilding", "Traversal", "Whole", "WritableMap", "assemble",
    "building_digest", "check_hash", "check_in_graph", "check_name", "check_places", "class_weights", "content_hash",
    "describe", "describe_map", "frame_of", "in_the_words_of", "kth_largest", "load", "matching_buildings",
    "move_rates", "object_weights", "pack_graph", "pack_history", "publish_map", "read", "read_meta", "reading_for",
    "stored_building", "unknown_building", "unpack_graph", "unpack_history",
]  # fmt: skip
