"""Reading a map on a Milvus server: its state, a model, a building; each checked, none half of one and half another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semloc_core.encoding import Model
from semloc_core.errors import MapError, SemlocError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.rows import (
    OBJECTS,
    MapRow,
    Pointer,
    check_building,
    integer,
    join_pieces,
    join_places,
    one_piece,
    pieces,
    text,
    unpack,
)
from semloc_core.fleet.milvus.server import MAX_ROWS, NoCollectionError, Server
from semloc_core.fleet.object_votes import MappedObjects
from semloc_core.map_database import MAX_BUILDINGS, PackedGraph, PlaceRows, StoredBuilding, unknown_building
from semloc_core.text import short_repr

_PIECES_AT_ONCE = 256  # 16 MiB of text
_POINTERS_AT_ONCE = 512  # at most 32 MiB
_PLACE_BYTES_AT_ONCE = 2**23
_MAX_CATALOGUE_BYTES = 2**28  # packed; some 400 a building, more where traversals were merged


@short_repr
@dataclass(frozen=True)
class State:
    """One state of a map's catalogue.

    Args:
        map_row: what the map says of itself.
        model_generation: where its model is.
        change: the number that the last change left.
        pointers: building -> its generation and row; names rising.
        known: the same by key, with rows that say that a building was removed.

    """

    map_row: MapRow
    model_generation: int
    change: int
    pointers: Mapping[str, tuple[int, Pointer]]
    known: Mapping[str, tuple[int, Pointer]]

    @cached_property
    def names(self) -> dict[int, str]:
        """Which building each generation is of."""
        return {generation: name for name, (generation, _) in self.pointers.items()}

    def generations(self) -> set[int]:
        """Generations that something points to."""
        return {self.model_generation, *self.names}


def read_change(server: Server, name: str, consistency: str = "Bounded") -> int | None:
    """The number that the last change left; None where there is no such map.

    Args:
        server: where.
        name: the map's.
        consistency: ``Strong`` for the last one; by default it may be some seconds old, and cheaper.

    """
    condition = f'key == "{layout.CHANGE}"'
    try:
        rows = server.query(layout.catalogue(name), condition, ("key", "generation"), 1, consistency)
    except NoCollectionError:
        return None
    return integer(rows[0], "generation") if rows else None


def state_now(server: Server, name: str, before: State) -> State:
    """The catalogue as it is now; cheap where nothing has changed."""
    rows = server.query(layout.catalogue(name), f'key == "{layout.CHANGE}"', ("key", "generation"), 1)
    if rows and integer(rows[0], "generation") == before.change:
        return before
    return read_state(server, name, before)


def read_state(server: Server, name: str, before: State | None = None) -> State:
    """The catalogue as it is now.

    Args:
        server: where.
        name: the map's.
        before: an earlier state; rows that are in it are not fetched again.

    Raises:
        MapError: no such map, or a damaged one.

    """
    for _ in range(5):
        try:
            found = _read_state(server, name, before)
        except NoCollectionError:
            raise no_map(server, name) from None
        if found is not None:
            return found
    raise MapError(f"expected a catalogue at rest for a moment (got one that keeps changing: {server.address})")


def _read_state(server: Server, name: str, before: State | None) -> State | None:
    """None where a row was written anew between two queries."""
    collection = layout.catalogue(name)
    most = 2 * MAX_BUILDINGS  # with rows of removed buildings
    # One query, so of one moment: what each row points to. What it says besides never changes with its generation.
    rows = server.query_all(collection, 'key != ""', ("key", "generation"), most)
    now = {text(row, "key"): integer(row, "generation") for row in rows}
    if layout.META not in now or layout.CHANGE not in now:
        raise no_map(server, name)
    change, model_generation = now.pop(layout.CHANGE), now.pop(layout.META)
    known = dict(before.known) if before is not None else {}
    fresh = sorted(key for key, generation in now.items() if key not in known or known[key][0] != generation)
    if before is not None and before.model_generation == model_generation:
        map_row = before.map_row
    else:
        generation, map_row = read_map_row(server, name)
        if generation != model_generation:
            return None
    for key, entry in read_pointers(server, name, fresh).items():
        if now[key] != entry[0]:
            return None
        known[key] = entry
    known = {key: known[key] for key in now if key in known and known[key][0] == now[key]}
    if len(known) != len(now):
        return None
    # A row that a writer left who still had the model of before a rebuild is no part of the map.
    valid = [entry for entry in known.values() if not entry[1].removed and entry[1].model == map_row.model_hash]
    if len(valid) > MAX_BUILDINGS:
        raise MapError(f"expected at most {MAX_BUILDINGS} buildings (got {len(valid)})")
    pointers = {entry[1].name: entry for entry in sorted(valid, key=lambda entry: entry[1].name)}
    return State(map_row, model_generation, change, pointers, known)


def read_map_row(server: Server, name: str) -> tuple[int, MapRow]:
    """What the map says of itself, and the generation of its model."""
    rows = server.query(layout.catalogue(name), f'key == "{layout.META}"', layout.CATALOGUE_FIELDS, 1)
    if not rows:
        raise no_map(server, name)
    return integer(rows[0], "generation"), unpack(rows[0].get("data"), MapRow)


def read_pointers(server: Server, name: str, keys: Sequence[str]) -> dict[str, tuple[int, Pointer]]:
    """Rows of buildings by key, with their generations; those that are not there are left out."""
    found, size = {}, 0
    for start in range(0, len(keys), _POINTERS_AT_ONCE):
        some = keys[start : start + _POINTERS_AT_ONCE]
        if not all(key.isalnum() and key.isascii() for key in some):
            raise MapError(f"expected keys of buildings in {server.address} (got others: the map is damaged)")
        listed = ", ".join(f'"{key}"' for key in some)
        for row in server.query(layout.catalogue(name), f"key in [{listed}]", layout.CATALOGUE_FIELDS, len(some)):
            key, pointer = text(row, "key"), unpack(row.get("data"), Pointer)
            size += len(row["data"])
            if size > _MAX_CATALOGUE_BYTES:
                raise MapError(f"expected a catalogue of at most {_MAX_CATALOGUE_BYTES} bytes (got more)")
            if key not in some or layout.building_key(pointer.name) != key:
                raise MapError(f"expected building {pointer.name!r} under its key (got another: the map is damaged)")
            found[key] = integer(row, "generation"), pointer
    return found


def no_map(server: Server, name: str) -> MapError:
    """The error for a map that is not there; says which ones are."""
    ending = layout.catalogue("")[len(layout.PREFIX) :]
    start = layout.PREFIX
    if layout.catalogue(name) in server.collections():
        at = f"map {name!r} at {server.address.uri}"
        return MapError(f"expected {at} (got one that was begun and never finished: push or build it again)")
    maps = [each[len(start) : -len(ending)] for each in server.collections() if each.startswith(start)]
    there = sorted({each for each in maps if layout.catalogue(each) in server.collections()})
    return MapError(f"expected a map {name!r} at {server.address.uri} (got maps: {', '.join(there[:8]) or 'none'})")


def read_blob(server: Server, name: str, generation: int, kind: str, size: int) -> bytes:
    """A blob of ``size`` bytes.

    Raises:
        MapError: it is not there, or something else.

    """
    parts, count = [], pieces(size)
    for first in range(0, count, _PIECES_AT_ONCE):
        some = min(_PIECES_AT_ONCE, count - first)
        condition = f'generation == {generation} and kind == "{kind}" and piece >= {first} and piece < {first + some}'
        rows = server.query(layout.blobs(name), condition, layout.BLOB_FIELDS, 2 * some)
        parts.append(join_pieces(rows, first, some, size))
    return b"".join(parts)


def read_model(server: Server, name: str, state: State) -> Model:
    """The model of a state, which is the one its hashes name."""
    row = state.map_row
    data = read_blob(server, name, state.model_generation, "model", row.model_bytes)
    try:
        model = Model.from_bytes(data)
    except SemlocError as error:
        raise MapError(f"expected a map that carries its model (got a damaged one: {error})") from error
    found = (model.hash, model.labelspace.hash, model.encoder.dimension)
    if found != (row.model_hash, row.labelspace_hash, row.dimension):
        raise MapError(f"expected model {row.model_hash[:12]} in the map (got {found[0][:12]}: the map is damaged)")
    return model


def read_building(
    server: Server, name: str, dimension: int, generation: int, pointer: Pointer
) -> tuple[StoredBuilding, PlaceRows]:
    """The building that a pointer points to.

    Raises:
        MissingRowsError: it is not there any more.
        MapError: it is not what was committed.

    """
    stored = read_stored(server, name, generation, pointer)
    parts = []
    step = max(1, min(MAX_ROWS // 2, _PLACE_BYTES_AT_ONCE // (4 * dimension + 256)))
    for first in range(0, pointer.n_places, step):
        some = min(step, pointer.n_places - first)
        condition = f"generation == {generation} and row >= {first} and row < {first + some}"
        rows = server.query(layout.places(name, dimension), condition, layout.PLACE_FIELDS, 2 * some)
        parts.append(join_places(rows, first, some, dimension))
    places = PlaceRows(
        tuple(id_ for part in parts for id_ in part.ids),
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.embeddings for part in parts]),
    )
    check_building(pointer, stored, places)
    return stored, places


def read_stored(server: Server, name: str, generation: int, pointer: Pointer) -> StoredBuilding:
    """A building without its places; by itself its scene graph is checked, its history is not."""
    graph = read_blob(server, name, generation, "graph", pointer.graph_packed)
    history = read_blob(server, name, generation, "history", pointer.history_bytes)
    packed = PackedGraph(pointer.graph_digest, pointer.graph_bytes, graph)
    return StoredBuilding(
        pointer.name, pointer.source, pointer.frame_id, pointer.stamp_ns, pointer.n_places, packed, history
    )


def read_objects(server: Server, name: str, generations: Sequence[int], n_classes: int) -> dict[int, MappedObjects]:
    """The objects of buildings by generation; those that were written before maps said them are left out.

    Raises:
        MapError: something else is there.

    """
    found: dict[int, MappedObjects] = {}
    for start in range(0, len(generations), _POINTERS_AT_ONCE):
        some = generations[start : start + _POINTERS_AT_ONCE]
        condition = f'kind == "{OBJECTS}" and generation in [{", ".join(map(str, some))}]'
        for row in server.query(layout.blobs(name), condition, layout.BLOB_FIELDS, 2 * len(some)):
            generation = integer(row, "generation")
            if generation not in some:
                raise MapError("expected objects of buildings asked for (got others: the map is damaged)")
            found[generation] = MappedObjects.unpack(one_piece(row), n_classes)
    return found


def current(read: Callable[[], State], again: Callable[[], State], building: str) -> tuple[int, Pointer]:
    """Where a building is now; looked up anew where the state at hand does not have it."""
    for state in (read(), again()):
        if building in state.pointers:
            return state.pointers[building]
    raise unknown_building(building, list(state.pointers))
