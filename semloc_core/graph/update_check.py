"""What can be wrong with an update that only the graph can tell, or that was not decoded from the wire. Reads only."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Container

from semloc_core.errors import GraphError
from semloc_core.wire import Object, Place, SceneGraphUpdate, one_line

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
    except GraphError as error:  # ids may be as long as a message
        raise GraphError(one_line(str(error))) from None


def _check(update: SceneGraphUpdate, known_places: Container[str], known_objects: Container[str]) -> None:
    places = {place.id for place in update.places}
    objects = {thing.id for thing in update.objects}
    if len(places) < len(update.places) or len(objects) < len(update.objects) or places & objects:
        counts = Counter([place.id for place in update.places] + [thing.id for thing in update.objects])
        node, times = counts.most_common(1)[0]
        raise GraphError(f"expected each node once in an update (got {node!r} {times} times)")
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

    def is_place(node: str) -> bool:
        return node in places or kept(node, known_places)

    def is_object(node: str) -> bool:
        return node in objects or kept(node, known_objects)

    _check_links(update, is_place, is_object)


def _check_links(update: SceneGraphUpdate, is_place: Callable[[str], bool], is_object: Callable[[str], bool]) -> None:
    for a, b in update.edges:
        if a == b:
            raise GraphError(f"expected an edge between two nodes (got a self-loop of {a!r})")
        if not (is_place(a) or is_place(b)):
            if is_object(a) and is_object(b):
                raise GraphError(f"expected an edge to have a place at one end (got objects {a!r} and {b!r})")
            raise GraphError(f"expected edges between known nodes (got unknown {(b if is_object(a) else a)!r})")
        for node in (a, b):
            if not (is_place(node) or is_object(node)):
                raise GraphError(f"expected edges between known nodes (got unknown {node!r})")
    for place, seen in update.sightings:
        if not (is_place(place) and is_object(seen)):
            raise GraphError(f"expected a sighting [place, object] of known nodes (got [{place!r}, {seen!r}])")
    if update.query_place is not None and not is_place(update.query_place):
        raise GraphError(f"expected query_place to be a place of the graph (got {update.query_place!r})")


def _check_position(node: Place | Object) -> None:
    if not all(abs(x) <= MAX_COORDINATE_M for x in node.position):  # false for NaN and infinity too
        bound = f"±{MAX_COORDINATE_M:g} m"
        raise GraphError(f"expected a position within {bound} (got {list(node.position)} for {node.id!r})")
