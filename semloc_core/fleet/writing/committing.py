"""Changing a map on a Milvus server: written under new generations first, made visible by one request at the end.

Killed before that request, a writer leaves the map as it was, and rows that nothing points to; a sweep finds them by
the row that each generation has from before its first row of content on.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.reading import State, state_now
from semloc_core.fleet.milvus.rows import (
    FORMAT_VERSION,
    OBJECTS,
    MapRow,
    Pointer,
    Row,
    blob_rows,
    integer,
    pack,
    place_rows,
)
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.object_votes import objects_of
from semloc_core.fleet.writing.conflicts import Draft, check_unchanged
from semloc_core.graph import Labelspace, read_graph
from semloc_core.map_database import MAX_BLOB_BYTES, unpack_graph

_RENEW_S = 30.0
_BYTES_AT_ONCE = 4 * 2**20
_ROWS_AT_ONCE = 4096


def map_row(model: Model, data: bytes) -> MapRow:
    """What a map says of itself, given its model and that packed."""
    if len(data) > MAX_BLOB_BYTES:
        raise MapError(f"expected a model of at most {MAX_BLOB_BYTES} bytes (got {len(data)})")
    return MapRow(
        format=FORMAT_VERSION,
        model_hash=model.hash,
        model_name=model.encoder.name,
        model_bytes=len(data),
        labelspace_hash=model.labelspace.hash,
        labelspace_name=model.labelspace.name,
        dimension=model.encoder.dimension,
    )


def commit(
    server: Server,
    name: str,
    before: State | None,
    drafts: Mapping[str, Draft | None],
    model: Model | None = None,
    labelspace: Labelspace | None = None,
) -> None:
    """Write buildings, remove others, put another model in: all visible at once.

    (What is said in the catalogue of more than some thousand buildings goes in several requests.)

    Args:
        server: where.
        name: the map's.
        before: the state that the drafts were made from; None for a map that is not there yet.
        drafts: by building; None removes it.
        model: the map's from now on; None leaves it.
        labelspace: the map's from now on, where a building is written.

    Raises:
        MapError: a draft's base is no longer current, the map has another model by now, the server refuses. The map
            is as it was, unless the connection was lost during the last request: then as before or as after.

    """
    assert before is not None or model is not None
    upload = _Upload(server, name)
    data = model.to_bytes() if model is not None else b""
    row = map_row(model, data) if model is not None else None
    of_map = row if row is not None else before.map_row if before is not None else None
    assert of_map is not None
    flip: list[Row] = []
    if row is not None:
        generation = upload.begin()
        upload.put(layout.blobs(name), blob_rows(generation, "model", data))
        flip.append(_catalogue_row(layout.META, generation, pack(row)))
    for building, draft in drafts.items():
        key = layout.building_key(building)
        if draft is None:
            last = before.pointers.get(building) if before is not None else None
            if last is not None:
                flip.append(_catalogue_row(key, 0, pack(_tombstone(last[1]))))
            continue
        pointer = pack(Pointer.of(draft.stored, draft.places, of_map.model_hash))
        generation = upload.begin()
        upload.put(layout.blobs(name), blob_rows(generation, "graph", draft.stored.graph.data))
        upload.put(layout.blobs(name), blob_rows(generation, "history", draft.stored.history))
        assert labelspace is not None
        objects = objects_of(read_graph(unpack_graph(draft.stored.graph), labelspace), labelspace)
        upload.put(layout.blobs(name), blob_rows(generation, OBJECTS, objects.pack()))
        upload.put(layout.places(name, of_map.dimension), place_rows(generation, draft.places))
        flip.append(_catalogue_row(key, generation, pointer))
    replaced: set[int] = set()
    if before is not None:
        now = state_now(server, name, before)
        check_unchanged(before, now, drafts, rebuilt=row is not None)
        replaced = {now.pointers[building][0] for building in drafts if building in now.pointers}
        if row is not None:
            replaced.add(now.model_generation)
    upload.finish(replaced)
    flip.append(_catalogue_row(layout.CHANGE, layout.new_generation(), ""))
    for part in _parts(flip):
        server.upsert(layout.catalogue(name), part)


def _tombstone(pointer: Pointer) -> Pointer:
    fields = {field: getattr(pointer, field) for field in pointer.__struct_fields__}
    return Pointer(**(fields | {"removed": True, "changes": {}}))


def _catalogue_row(key: str, generation: int, data: str) -> Row:
    return {"key": key, "generation": generation, "data": data, "embedding": layout.PAD}


def _parts(rows: Iterable[Row]) -> Iterable[list[Row]]:
    """Rows in requests that a server takes."""
    part: list[Row] = []
    size = 0
    for row in rows:
        part.append(row)
        size += 64 + sum(len(value.encode()) if isinstance(value, str) else 8 for value in row.values())
        size += 4 * len(row["embedding"])
        if size >= _BYTES_AT_ONCE or len(part) == _ROWS_AT_ONCE:
            yield part
            part, size = [], 0
    if part:
        yield part


class _Upload:
    """Rows of new generations on their way to the server."""

    def __init__(self, server: Server, name: str) -> None:
        self._server = server
        self._name = name
        self._begun: list[int] = []
        self._renewed = time.monotonic()

    def begin(self) -> int:
        """A new generation, known to the server before anything is in it."""
        generation = layout.new_generation()
        while generation in self._begun:
            generation = layout.new_generation()
        self._begun.append(generation)
        self._touch([generation])
        return generation

    def put(self, collection: str, rows: Iterable[Row]) -> None:
        """Write rows of the generation begun last."""
        for part in _parts(rows):
            self._server.insert(collection, part)
            if time.monotonic() - self._renewed > _RENEW_S:
                self._touch(self._begun)

    def finish(self, replaced: set[int]) -> None:
        """The grace time of what was written, and of what it replaces, begins now.

        Raises:
            MapError: something of it was swept.

        """
        for start in range(0, len(self._begun), _ROWS_AT_ONCE):
            some = self._begun[start : start + _ROWS_AT_ONCE]
            listed = ", ".join(map(str, some))
            there = self._server.query(
                layout.generations(self._name), f"generation in [{listed}]", ("generation",), len(some)
            )
            if {integer(row, "generation") for row in there} != set(some):
                raise MapError("expected what was written so far (got a sweep that took it; the map is as it was)")
        self._touch([*self._begun, *sorted(replaced)])

    def _touch(self, some: list[int]) -> None:
        now = layout.now_ms()
        rows: list[Row] = [{"generation": each, "touched_ms": now, "embedding": layout.PAD} for each in some]
        for part in _parts(rows):
            self._server.upsert(layout.generations(self._name), part)
        self._renewed = time.monotonic()
