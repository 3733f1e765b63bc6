"""Merges into maps: read, merged, embedded anew and written, in one transaction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from semloc_core.encoding import Model, embed_graph
from semloc_core.errors import MapError
from semloc_core.graph import GraphArrays, SceneGraph
from semloc_core.map_database import (
    MAX_HISTORY_BYTES,
    Before,
    History,
    PackedGraph,
    ReadableMap,
    Traversal,
    WritableMap,
    class_weights,
    object_weights,
    pack_graph,
    pack_history,
    unpack_graph,
    unpack_history,
)
from semloc_core.map_merge.align import Alignment
from semloc_core.map_merge.config import MergeConfig
from semloc_core.map_merge.merging import Merged, lay, merge
from semloc_core.map_merge.sides import Side


def merge_into(
    database: WritableMap,
    model: Model,
    traversal: SceneGraph,
    building: str | None = None,
    *,
    config: MergeConfig | None = None,
    source: str = "",
    again: bool = False,
) -> tuple[str, Merged]:
    """Merge a traversal into a building of a map, and embed its places anew with what its objects weigh by now.

    What the building was before is kept with it, for `undo`.

    Args:
        database: the map, open for changes.
        model: the map's.
        traversal: in any frame whose z axis is up.
        building: which one; None: the one that it fits best.
        config: options.
        source: where the traversal came from, such as a file name.
        again: merge it even if the building has had it: what it saw then counts twice.

    Returns:
        The building's name, and what it has become.

    Raises:
        MapError: the traversal does not fit the building, or none; it has nothing to fit by; the building has had it.
            The map is as it was.

    """
    with database.transaction():
        name, merged = propose(database, model, traversal, building, config=config, source=source, again=again)
        history = msgspec.structs.replace(merged.history, before=_before(database, name))
        write(database, model, name, merged.graph, history)
    return name, merged


def undo(database: WritableMap, model: Model, building: str | None = None) -> tuple[str, Traversal]:
    """Take the last merge into a building back: graph, history and embeddings are as they were before it.

    One step: the merge before that one stays.

    Args:
        database: the map, open for changes.
        model: the map's.
        building: which one; None: the only one that has a merge to undo.

    Returns:
        The building's name, and the traversal that is no longer merged.

    Raises:
        MapError: there is no merge to undo, or in several buildings. The map is as it was.

    """
    with database.transaction():
        names = database.buildings if building is None else (building,)
        histories = {name: database.history(name) for name in names}
        found = [name for name, history in histories.items() if history.before is not None]
        if len(found) != 1:
            where = f"building {building!r}" if building is not None else "the map"
            got = f"{len(found)}: name one of {', '.join(found)}" if found else "none, or it was changed since"
            raise MapError(f"expected one merge to undo in {where} (got {got})")
        (name,) = found
        before = histories[name].before
        assert before is not None
        graph = unpack_graph(PackedGraph(before.digest, before.size, before.graph))
        write(database, model, name, graph, unpack_history(before.history))
    return name, histories[name].traversals[-1]


def _before(map_: ReadableMap, name: str) -> Before | None:
    """What undoes a merge; None of a building so large that it does not fit into its history."""
    packed = pack_graph(map_.graph(name), "")
    history = pack_history(msgspec.structs.replace(map_.history(name), before=None))
    small = len(packed.data) + len(history) < MAX_HISTORY_BYTES // 4
    return Before(packed.digest, packed.size, packed.data, history) if small else None


def propose(
    map_: ReadableMap,
    model: Model,
    traversal: SceneGraph,
    building: str | None = None,
    *,
    config: MergeConfig | None = None,
    source: str = "",
    again: bool = False,
) -> tuple[str, Merged]:
    """What `merge_into` would make of a map; writes nothing. Arguments, result and errors are the same."""
    config = config or MergeConfig()
    map_.require(model.hash, model.labelspace.hash)
    names = map_.buildings if building is None else (building,)
    if not names:
        raise MapError("expected a map with a building to merge into (got an empty one)")
    run = pack_graph(traversal, "").digest
    for name in names if not again else ():
        _check_new(run, map_.history(name), name, source)
    seen = side(model, traversal, map_weights(map_, model))
    name = names[0] if len(names) == 1 else _best(map_, model, seen, names, config)
    mapped, history = stored_side(map_, model, name), map_.history(name)
    others = [map_.changes(other) for other in map_.buildings if other != name]
    if not (again or history.traversals) and run == pack_graph(mapped.graph, "").digest:
        raise MapError(
            f"expected a later traversal of building {name!r} (got {source or 'one'}, that it was mapped from)"
        )
    return name, merge(mapped, history, seen, others=others, config=config, source=source, name=name, run=run)


def _check_new(run: str, history: History, name: str, source: str) -> None:
    """Refuse a traversal that a building has had."""
    for number, had in enumerate(history.traversals, 1):
        if had.run == run:
            raise MapError(
                f"expected a traversal that building {name!r} has not had (got {source or 'one'}, merged before as "
                f"number {number} of {len(history.traversals)}, {had.source or 'without a name'})"
            )


def write(database: WritableMap, model: Model, name: str, graph: SceneGraph, history: History) -> None:
    """Store a building as it is now, and embed the map anew: what a class weighs, it weighs in all buildings.

    Args:
        database: the map, open for changes.
        model: the map's.
        name: the building.
        graph: its scene graph.
        history: its history.

    """
    with database.transaction():
        arrays = GraphArrays.from_scene_graph(graph, model.labelspace)
        before = map_weights(database, model)
        nothing = np.zeros((arrays.n_places, model.encoder.dimension), dtype=np.float32)
        database.revise_building(name, graph, arrays.place_positions, nothing, history)
        changed = map_weights(database, model) != before
        embed_again(database, model, database.buildings if changed else [name])


def put_building(
    database: WritableMap, model: Model, graph: SceneGraph, name: str, *, source: str = "", replace: bool = False
) -> int:
    """Put a whole building into a map, its places embedded by the map's model.

    Args:
        database: the map, open for changes.
        model: the map's own.
        graph: the building; at least one place.
        name: it is known by.
        source: where it came from, such as a file name.
        replace: the map has it already, and this is what it has become.

    Returns:
        How many places it has.

    Raises:
        MapError: the name is taken, or is not there to be replaced; the map is as it was.

    """
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace, name)
    before = map_weights(database, model)
    write = database.replace_building if replace else database.add_building
    nothing = np.zeros((arrays.n_places, model.encoder.dimension), dtype=np.float32)
    write(name, graph, arrays.place_ids, arrays.place_positions, nothing, source=source)
    embed_again(database, model, database.buildings if map_weights(database, model) != before else [name])
    return arrays.n_places


def embed_again(database: WritableMap, model: Model, names: Sequence[str]) -> None:
    """Embed buildings of a map with what their objects weigh by now: for whoever changes histories or adds any."""
    of_class = map_weights(database, model)
    for name in names:
        graph = database.graph(name)
        weights = object_weights(graph, model.labelspace, database.history(name), of_class)
        arrays = GraphArrays.from_scene_graph(graph, model.labelspace)
        kept = np.isin(arrays.place_ids, database.place_ids(name))  # a map may leave places of a graph out
        ids = [place for place, stays in zip(arrays.place_ids, kept.tolist(), strict=True) if stays]
        z = embed_graph(model, arrays, weights)
        database.replace_places(name, ids, arrays.place_positions[kept], z[kept])


def map_weights(map_: ReadableMap, model: Model) -> dict[str, float]:
    """What each class weighs in a map."""
    return class_weights([map_.changes(name) for name in map_.buildings], model.labelspace)


def side(model: Model, graph: SceneGraph, of_class: Mapping[str, float], history: History | None = None) -> Side:
    """A graph with its places embedded: a traversal's, its objects weighed by class only, or a building's."""
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace)
    weights = object_weights(graph, model.labelspace, history or History(), of_class)
    return Side.of(graph, model.labelspace, embed_graph(model, arrays, weights))


def stored_side(map_: ReadableMap, model: Model, name: str) -> Side:
    """A building of a map, embedded with its objects' weights."""
    return side(model, map_.graph(name), map_weights(map_, model), map_.history(name))


def _best(map_: ReadableMap, model: Model, seen: Side, names: Sequence[str], config: MergeConfig) -> str:
    """The building on which the traversal is laid with most support."""
    found: list[tuple[Alignment, str]] = []
    refused: list[str] = []
    for name in names:
        try:
            found.append((lay(stored_side(map_, model, name), seen, config, name), name))
        except MapError as error:
            refused.append(str(error))
    if not found:
        raise MapError(f"expected a traversal of one of {len(names)} buildings (got none that it fits: {refused[0]})")
    return max(found, key=lambda one: one[0].score)[1]
