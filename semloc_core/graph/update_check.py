"""What can be wrong with an update that only the graph can tell, or that was not decoded from the wire. Reads only."""

from __future__ import annotations

import math
from collections.abc import Container

from semloc_core.errors import GraphError, MessageError
from semloc_core.wire import Object, Place, SceneGraphUpdate, check_links, check_nodes, one_line

MAX_COORDINATE_M = 1e9  # beyond it a length would not be a number that means anything


def check_update(update: SceneGraphUpdate, known_places: Container[str], known_objects: Container[str]) -> None:
    """Refuse an update that does not fit the graph; costs the update's size.

    Args:
        update: the message.
        known_places: ids of the graph's places (a full update does not look at them).
        known_objects: ids of the graph's objects (likewise).

    Raises:
        GraphError: the first thing that is wrong, in one line; see `semloc_core.graph.scene_graph.SceneGraph.apply`.

    """
    try:
        _check(update, known_places, known_objects)
    except (GraphError, MessageError) as error:  # ids may be as long as a message
        raise GraphError(one_line(str(error))) from None


def _check(update: SceneGraphUpdate, known_places: Container[str], known_objects: Container[str]) -> None:
    places, objects = check_nodes(update)
    for place in update.places:
        _check_position(place)
    for thing in update.objects:
        _check_position(thing)
        if thing.size is not None and not all(map(math.isfinite, thing.size)):
            raise GraphError(f"expected a finite size (got {list(thing.size)} for {thing.id!r})")
    gone = frozenset(update.removed_nodes)

    def kept(node: str, known: Container[str]) -> bool:
        return not update.full and node in known and node not in gone

    for node in places:
        if kept(node, known_objects):
            raise GraphError(f"expected node {node!r} to stay an object (got a place)")
    for node in objects:
        if kept(node, known_places):
            raise GraphError(f"expected node {node!r} to stay a place (got an object)")
    check_links(
        update,
        lambda node: node in places or kept(node, known_places),
        lambda node: node in objects or kept(node, known_objects),
    )


def _check_position(node: Place | Object) -> None:
    if not all(abs(x) <= MAX_COORDINATE_M for x in node.position):  # false for NaN and infinity too
        bound = f"±{MAX_COORDINATE_M:g} m"
        raise GraphError(f"expected a position within {bound} (got {list(node.position)} for {node.id!r})")
