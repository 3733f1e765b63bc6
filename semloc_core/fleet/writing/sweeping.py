"""Tidying up after writers: what nothing points to any more is deleted once it is old enough.

It is left alone for a grace time, since a writer may still be at work on it, or a reader on what was replaced. A
reader that is slower finds rows missing, and looks where the building is now.
"""

from __future__ import annotations

import logging

from semloc_core.errors import MapError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.reading import State, read_state
from semloc_core.fleet.milvus.rows import integer
from semloc_core.fleet.milvus.server import Server
from semloc_core.map_database import MAX_BUILDINGS

logger = logging.getLogger(__name__)

GRACE_S = 3600.0


def sweep(server: Server, name: str, older_than_s: float = GRACE_S, state: State | None = None) -> int:
    """Delete what nothing points to: left by writers that were killed, or replaced since.

    Args:
        server: where.
        name: the map's.
        older_than_s: leave alone what was written or replaced less than this ago, by the clocks of the machines that
            did.
        state: of the map, lately; saves reading it whole.

    Returns:
        How many generations were deleted.

    Raises:
        MapError: no such map, or the server refuses.

    """
    if not older_than_s >= 0:
        raise MapError(f"expected a grace time of at least 0 s (got {older_than_s})")
    collection = layout.generations(name)
    state = read_state(server, name, state)
    before = layout.now_ms() - int(older_than_s * 1000)
    condition = f"touched_ms < {before}" if older_than_s > 0 else f"touched_ms <= {before}"
    rows = server.query_all(collection, condition, ("generation",), 4 * MAX_BUILDINGS)
    old = {integer(row, "generation") for row in rows}
    # After the list was read: what another writer made visible in between is in use.
    garbage = sorted(old - read_state(server, name, state).generations())
    if not garbage:
        return 0
    start = layout.places(name, 0)[:-1]
    with_places = [each for each in server.collections() if each.startswith(start) and each[len(start) :].isdigit()]
    for generation in garbage:
        for each in (*with_places, layout.blobs(name), collection):  # its own row last: until then it is found again
            server.delete(each, f"generation == {generation}")
    logger.info("%s: %d generations swept", server.address, len(garbage))
    return len(garbage)
