"""Maps of fleets: kept by a server that many robots query and several writers change at once."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.fleet.file_source import FileSource, LoadedSource
    from semloc_core.fleet.holdings import Holdings
    from semloc_core.fleet.link import Link
    from semloc_core.fleet.localiser import FleetLocaliser
    from semloc_core.fleet.milvus.address import MilvusAddress, is_address, parse_address
    from semloc_core.fleet.milvus.collections import INDEX_KINDS
    from semloc_core.fleet.milvus.creating import map_exists
    from semloc_core.fleet.milvus.server import Server
    from semloc_core.fleet.milvus.source import MilvusSource
    from semloc_core.fleet.narrowing import ShortlistConfig, shortlist
    from semloc_core.fleet.object_votes import MappedObjects, ObjectVotes, nearest_first
    from semloc_core.fleet.open_map import localiser_in, open_localiser
    from semloc_core.fleet.source import Nearest
    from semloc_core.fleet.writing.database import FleetDatabase
    from semloc_core.fleet.writing.transfer import pull, push
else:
    __getattr__ = exports(__name__)

__all__ = [
    "FileSource", "FleetDatabase", "FleetLocaliser", "Holdings", "INDEX_KINDS", "Link", "LoadedSource", "MappedObjects",
    "MilvusAddress", "MilvusSource", "Nearest", "ObjectVotes", "Server", "ShortlistConfig", "is_address",
    "localiser_in", "map_exists", "nearest_first", "open_localiser", "parse_address", "pull", "push", "shortlist",
]  # fmt: skip
