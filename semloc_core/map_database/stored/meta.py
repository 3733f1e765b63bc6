"""What binds a map together: hashes of its model, labelspace and content; and the model itself, kept in the file."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass

from semloc_core.encoding import Model
from semloc_core.errors import MapError, SemlocError
from semloc_core.map_database.stored.records import (
    building_digest,
    content_hash,
    keep_storeys,
    read_history_bytes,
    read_places,
)
from semloc_core.map_database.stored.schema import MAX_BLOB_BYTES


@dataclass(frozen=True)
class MapMeta:
    """What a map says of itself; ``generation`` counts committed changes, the rest is content."""

    model_hash: str
    model_name: str
    labelspace_hash: str
    labelspace_name: str
    dimension: int
    content_hash: str
    generation: int


def check_hash(what: str, expected: str | None, found: str, found_name: str, map_name: str) -> None:
    """Refuse a map made with another model or labelspace; None expects nothing."""
    if expected is not None and expected != found:
        raise MapError(f"expected map {map_name!r} made with {what} {expected[:12]} (got {found_name} {found[:12]})")


def read_meta(connection: sqlite3.Connection) -> MapMeta:
    """Read what the map says of itself."""
    rows = connection.execute("SELECT key, value FROM meta LIMIT 99").fetchall()
    values = dict(rows)
    if set(values) != set(MapMeta.__dataclass_fields__) or not all(isinstance(value, str) for value in values.values()):
        raise MapError("expected a map that names its model, labelspace and content (got one that does not)")
    try:
        numbers = {key: int(values.pop(key)) for key in ("dimension", "generation")}
    except ValueError:
        raise MapError("expected numbers for dimension and generation (got text: the map is damaged)") from None
    return MapMeta(**(values | numbers))


def read_model(connection: sqlite3.Connection, meta: MapMeta) -> Model:
    """Read the model and check that it is the one the embeddings were made with."""
    row = connection.execute("SELECT data FROM model").fetchone()
    if row is None or not isinstance(row[0], bytes):
        raise MapError("expected a map that carries its model (got none)")
    try:
        model = Model.from_bytes(row[0])
    except SemlocError as error:
        raise MapError(f"expected a map that carries its model (got a damaged one: {error})") from error
    if (meta.model_hash, meta.labelspace_hash) != (found := (model.hash, model.labelspace.hash)):
        named = f"{meta.model_hash[:12]} with labelspace {meta.labelspace_hash[:12]}"
        raise MapError(f"expected model {named} in the map (got {found[0][:12]} with {found[1][:12]})")
    if model.encoder.dimension != meta.dimension:
        raise MapError(f"expected embeddings of {model.encoder.dimension} numbers (got {meta.dimension})")
    return model


def write_model(connection: sqlite3.Connection, model: Model, generation: int) -> None:
    """Put a model into the map, and what follows from it; the buildings' embeddings are the caller's to replace."""
    data = model.to_bytes()
    if len(data) > MAX_BLOB_BYTES - 1024:
        raise MapError(f"expected a model of at most {MAX_BLOB_BYTES - 1024} bytes (got {len(data)})")
    connection.execute("INSERT OR REPLACE INTO model (id, data) VALUES (0, ?)", (data,))
    meta = MapMeta(
        model_hash=model.hash,
        model_name=model.encoder.name,
        labelspace_hash=model.labelspace.hash,
        labelspace_name=model.labelspace.name,
        dimension=model.encoder.dimension,
        content_hash=content_hash(model.hash, model.labelspace.hash, []),
        generation=generation,
    )
    _write_meta(connection, {key: str(value) for key, value in vars(meta).items()})


def seal(connection: sqlite3.Connection) -> None:
    """Before a commit: digests of the buildings that changed, the content hash, the next generation."""
    meta = read_meta(connection)
    changed = "SELECT id, frame_id, graph_digest FROM building WHERE digest IS NULL ORDER BY name"
    for key, frame_id, graph_digest in connection.execute(changed).fetchall():
        places = read_places(connection, key, meta.dimension)
        digest = building_digest(places, frame_id, graph_digest, read_history_bytes(connection, key))
        connection.execute("UPDATE building SET digest = ? WHERE id = ?", (digest, key))
        keep_storeys(connection, key)
    digests = connection.execute("SELECT name, digest FROM building").fetchall()
    fresh = content_hash(meta.model_hash, meta.labelspace_hash, digests)
    _write_meta(connection, {"content_hash": fresh, "generation": str(meta.generation + 1)})


def _write_meta(connection: sqlite3.Connection, values: Mapping[str, str]) -> None:
    connection.executemany("INSERT OR REPLACE INTO meta (key, value) VALUES (?, ?)", values.items())
