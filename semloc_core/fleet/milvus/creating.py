"""Making the collections of a map on a Milvus server."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from semloc_core.encoding import Model
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.reading import read_change
from semloc_core.fleet.milvus.server import Server


def make_collections(server: Server, model: Model, index: str) -> None:
    """The collections of a map with a model's number of dimensions, those that are not there yet.

    Args:
        server: where.
        model: of the map.
        index: kind of index; empty: the same as the map's other places have.

    """
    name = server.address.name
    if not index:
        start = layout.places(name, 0)[:-1]
        others = [each for each in server.collections() if each.startswith(start)]
        index = (server.index_type(others[0]) if others else "") or layout.INDEX_KINDS[0]
    dimension = model.encoder.dimension
    with ThreadPoolExecutor() as pool:  # pymilvus waits half a second for every index
        done = [
            pool.submit(
                server.create, collection, fields, index if collection == layout.places(name, dimension) else "FLAT"
            )
            for collection, fields in layout.collections(name, dimension).items()
        ]
    for each in done:
        each.result()


def has_map(server: Server) -> bool:
    """Whether there is a map of that name: collections without the map's own row are none."""
    name = server.address.name
    return layout.catalogue(name) in server.collections() and read_change(server, name, "Strong") is not None


def map_exists(address: MilvusAddress) -> bool:
    """Whether there is a map at an address.

    Raises:
        MapUnavailableError: no server answers there.

    """
    server = Server(address)
    try:
        return has_map(server)
    finally:
        server.close()
