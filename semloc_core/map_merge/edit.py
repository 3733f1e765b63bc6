"""Single places of a building added, replaced or removed by hand, with the objects that hang on them."""

from __future__ import annotations

from collections.abc import Collection

import msgspec

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.graph import SceneGraph
from semloc_core.map_database import WritableMap
from semloc_core.map_merge.store import write
from semloc_core.wire import Place


def without_places(graph: SceneGraph, places: Collection[str]) -> SceneGraph:
    """The graph without some places, nor the objects that have no other parent.

    Raises:
        MapError: a place that the graph lacks, or no place would be left.

    """
    for place in places:
        if place not in graph.places:
            raise MapError(f"expected places of the building (got {place!r}, which it does not have)")
    if len(set(places)) == len(graph.places):
        raise MapError("expected a place that stays (got all of them: remove the building)")
    rest, gone = _copy(graph), set(places)
    orphans = {child for place in gone for child in rest.children.get(place, ()) if rest.parents[child] <= gone}
    rest.amend(removed_nodes=sorted(gone | orphans))
    return rest


def with_places(graph: SceneGraph, newer: SceneGraph, places: Collection[str], *, replace: bool) -> SceneGraph:
    """The graph with some places as a newer graph of the building has them.

    Their edges, and the objects that hang on them, come along. A place that is replaced also keeps its edges to places
    that the newer graph lacks; objects that hung on replaced places only are as in the newer graph, or gone.

    Args:
        graph: the building.
        newer: in the same frame, with the same ids.
        places: which; none that ``graph`` has unless ``replace``, then only such.
        replace: replace instead of add.

    Raises:
        MapError: a place that ``newer`` lacks, one that is there already or, with ``replace``, is not.

    """
    for place in places:
        if place not in newer.places:
            raise MapError(f"expected places of the graph given (got {place!r}, which it does not have)")
        if (place in graph.places) != replace:
            found = "which it has" if place in graph.places else "which it does not have"
            raise MapError(f"expected {'' if replace else 'new '}places of the building (got {place!r}, {found})")
    result, chosen = _copy(graph), set(places)
    kept: list[tuple[str, str]] = []
    if replace:
        kept = [(a, b) for a in chosen for b in graph.neighbours[a] if b not in newer.places]
        orphans = {
            child for place in chosen for child in result.children.get(place, ()) if result.parents[child] <= chosen
        }
        result.amend(removed_nodes=sorted(chosen | orphans))
    there = chosen | result.places.keys()
    children = {child for place in chosen for child in newer.children.get(place, ())}
    links = [(place, child) for child in children for place in newer.parents[child] if place in there]
    seen = [(place, child) for child in children for place in newer.sightings.get(child, ()) if place in there]
    edges = [(a, b) for a in chosen for b in newer.neighbours[a] if b in there]
    result.amend(
        [Place(place, newer.places[place]) for place in sorted(chosen)],
        [newer.objects[child] for child in sorted(children)],
        sorted(edges + kept) + sorted(links),
        sorted(seen),
    )
    return result


def store_edited(database: WritableMap, model: Model, name: str, graph: SceneGraph) -> None:
    """Put an edited scene graph in place of a building's; all its places are embedded anew.

    Args:
        database: the map, open for changes.
        model: the map's.
        name: the building.
        graph: of it; its history loses what it says of objects that are gone, and what would undo a merge.

    """
    history = database.history(name)
    beliefs = {key: belief for key, belief in history.objects.items() if key in graph.objects}
    write(database, model, name, graph, msgspec.structs.replace(history, objects=beliefs, before=None))


def _copy(graph: SceneGraph) -> SceneGraph:
    update = graph.to_update(seq=0, stamp_ns=0, frame_id="")
    return SceneGraph.from_update(msgspec.structs.replace(update, query_place=None))
