"""What a map file's rows hold: places checked on their way in and out, packed scene graphs, content digests."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import zlib
from collections import Counter
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import TypedDict, TypeVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from semloc_core.errors import GraphError, MapError, MessageError
from semloc_core.graph import SceneGraph, storeys_of
from semloc_core.map_database.building_patterns import unknown_building
from semloc_core.text import short_repr
from semloc_core.wire import decode_update, encode

F = TypeVar("F", np.float32, np.float64)

MAX_GRAPH_BYTES = 512 * 2**20  # of a building's scene graph as JSON
MOST_PACKED = 32
"""No graph is packed tighter than so many times (most are eight times), so that no small file unpacks to much."""
MAX_NAME_LENGTH = 1024
MAX_BUILDINGS = 100_000
_CHECK_BYTES = 32


@short_repr
@dataclass(frozen=True, eq=False)
class PlaceRows:
    """Places of one building, by rising id.

    Args:
        ids: P ids.
        positions: (P, 3) float64, metres, in the building's frame.
        embeddings: (P, D) float32, contiguous.

    """

    ids: tuple[str, ...]
    positions: NDArray[np.float64]
    embeddings: NDArray[np.float32]

    def only(self, ids: Container[str]) -> PlaceRows:
        """Some of them."""
        kept = [i for i, id_ in enumerate(self.ids) if id_ in ids]
        return PlaceRows(tuple(self.ids[i] for i in kept), self.positions[kept], self.embeddings[kept])

    def rows(self, building: int) -> Iterable[tuple[int, str, float, float, float, bytes]]:
        """As the table ``place`` holds them."""
        little_endian = self.embeddings.astype("<f4", copy=False)
        for id_, (x, y, z), embedding in zip(self.ids, self.positions.tolist(), little_endian, strict=True):
            yield building, id_, x, y, z, embedding.tobytes()


class Note(TypedDict, total=False):
    """What may be said of a building; only the frame is part of the content hash.

    Args:
        source: where it comes from, such as a file name; empty by default.
        frame_id: the frame of its positions, by default ``map``.
        stamp_ns: when it was made, by default None.

    """

    source: str
    frame_id: str
    stamp_ns: int | None


@short_repr
@dataclass(frozen=True)
class PackedGraph:
    """A building's scene graph: a full ``scene_graph_update`` in JSON, compressed by zlib."""

    digest: str
    size: int
    data: bytes


def check_name(what: str, name: str) -> None:
    """Refuse a name that could not be printed on one line or stored."""
    if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME_LENGTH or not name.isprintable():
        raise MapError(f"expected {what} of 1 to {MAX_NAME_LENGTH} printable characters (got {str(name)[:80]!r})")


def check_places(ids: Sequence[str], positions: ArrayLike, embeddings: ArrayLike, dimension: int) -> PlaceRows:
    """Check places that are to be stored.

    Args:
        ids: P place ids, unique, in any order.
        positions: (P, 3) metres.
        embeddings: (P, D) as the model gives them.
        dimension: D that the model has.

    Raises:
        MapError: shapes or D do not fit, a number is not finite, an id twice or unprintable.

    """
    for id_ in ids:
        check_name("a place id", id_)
    if len(set(ids)) != len(ids):
        twice, _ = Counter(ids).most_common(1)[0]
        raise MapError(f"expected each place once (got {twice!r} twice)")
    where, what = _numbers("positions", positions, np.float64), _numbers("embeddings", embeddings, np.float32)
    if where.shape != (len(ids), 3):
        raise MapError(f"expected positions of shape {(len(ids), 3)} (got {where.shape})")
    if what.shape != (len(ids), dimension):
        raise MapError(f"expected embeddings of shape {(len(ids), dimension)} (got {what.shape})")
    order = sorted(range(len(ids)), key=ids.__getitem__)
    return PlaceRows(tuple(ids[i] for i in order), where[order], np.ascontiguousarray(what[order]))


def _numbers(what: str, values: ArrayLike, dtype: type[F]) -> NDArray[F]:
    try:
        array: NDArray[F] = np.asarray(values, dtype=dtype)
    except (TypeError, ValueError):
        raise MapError(f"expected {what} as an array of numbers (got {type(values).__name__})") from None
    if not np.isfinite(array).all():
        raise MapError(f"expected finite {what} (got NaN or infinity)")
    return array


def building_names(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Names of the buildings, sorted."""
    rows = connection.execute("SELECT name FROM building ORDER BY name LIMIT ?", (MAX_BUILDINGS + 1,)).fetchall()
    if len(rows) > MAX_BUILDINGS:
        raise MapError(f"expected at most {MAX_BUILDINGS} buildings (got more)")
    if not all(isinstance(name, str) for (name,) in rows):
        raise MapError("expected building names as text (got others: the map is damaged)")
    return tuple(name for (name,) in rows)


def building_key(connection: sqlite3.Connection, name: str) -> int:
    """The key of a building's rows; MapError where the map does not have it."""
    row = connection.execute("SELECT id FROM building WHERE name = ?", (name,)).fetchone()
    if row is None:
        raise unknown_building(name, building_names(connection))
    key: int = row[0]
    return key


def read_history_bytes(connection: sqlite3.Connection, building: int) -> bytes:
    """A building's history as stored; empty where it has none, as in every map of format 1."""
    if not connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'history'").fetchone():
        return b""
    row = connection.execute("SELECT data FROM history WHERE building = ?", (building,)).fetchone()
    if row is not None and not isinstance(row[0], bytes):
        raise MapError("expected a building's history (got something else: the map is damaged)")
    return row[0] if row is not None else b""


def keep_storeys(connection: sqlite3.Connection, building: int) -> None:
    """Derive the storeys of a building's places from its scene graph, given its key, and store them."""
    row = connection.execute(
        "SELECT graph_digest, graph_bytes, graph FROM building WHERE id = ?", (building,)
    ).fetchone()
    ids = [id_ for (id_,) in connection.execute("SELECT id FROM place WHERE building = ? ORDER BY id", (building,))]
    on = derived_storeys(PackedGraph(*row), ids)
    data = np.array(on, dtype="<i2").tobytes()
    connection.execute(
        "INSERT OR REPLACE INTO storeys (building, data) VALUES (?, ?)", (building, _checked(row[0], ids, data))
    )


def read_storeys(
    connection: sqlite3.Connection, building: int, graph_digest: str, place_ids: Sequence[str]
) -> tuple[int, ...] | None:
    """The storeys of a building's places as they were stored; None in maps of formats 1 and 2, which have none.

    Args:
        connection: the open map.
        building: its key.
        graph_digest: of its scene graph.
        place_ids: its places, by rising id.

    Raises:
        MapError: they are not those of these places of that scene graph.

    """
    if not connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'storeys'").fetchone():
        return None
    row = connection.execute("SELECT data FROM storeys WHERE building = ?", (building,)).fetchone()
    data = row[0][_CHECK_BYTES:] if row is not None and isinstance(row[0], bytes) else b""
    if len(data) != 2 * len(place_ids) or row[0] != _checked(graph_digest, place_ids, data):
        raise MapError("expected the storeys of a building's places (got others: the map is damaged)")
    return tuple(np.frombuffer(data, dtype="<i2").tolist())


def _checked(graph_digest: str, place_ids: Sequence[str], data: bytes) -> bytes:
    """Storeys with a digest that binds them to places and scene graph.

    The content hash covers both, and with them all that storeys follow from: it is that of format 2.
    """
    head = json.dumps([graph_digest, list(place_ids)]).encode()
    return hashlib.sha256(head + data).digest() + data


def derived_storeys(graph: PackedGraph, place_ids: Sequence[str]) -> tuple[int, ...]:
    """The storeys of some places of a stored scene graph, from the graph alone.

    Raises:
        MapError: the graph is not what was stored, or lacks a place.

    """
    on = storeys_of(unpack_graph(graph))
    if not all(id_ in on for id_ in place_ids):
        raise MapError("expected places of the building's scene graph (got others: the map is damaged)")
    return tuple(on[id_] for id_ in place_ids)


def read_places(connection: sqlite3.Connection, building: int, dimension: int) -> PlaceRows:
    """Read a building's places.

    Args:
        connection: the open map.
        building: its key.
        dimension: D that the model has.

    Raises:
        MapError: a row that is not what was written, or more rows than a file of this size can hold (in a forged
            file, pages may be used over and over).

    """
    pages, page_bytes = (connection.execute(f"PRAGMA {what}").fetchone()[0] for what in ("page_count", "page_size"))
    most = pages * page_bytes // (4 * dimension) + 1
    query = "SELECT id, x, y, z, embedding FROM place WHERE building = ? ORDER BY id LIMIT ?"
    rows = connection.execute(query, (building, most + 1)).fetchall()
    if len(rows) > most:
        raise MapError(f"expected at most {most} places in a file of this size (got more: it is damaged)")
    if not rows:
        return PlaceRows((), np.zeros((0, 3)), np.zeros((0, dimension), dtype=np.float32))
    ids, x, y, z, blobs = zip(*rows, strict=True)
    if set(map(type, ids)) != {str}:
        raise MapError("expected place ids as text (got others: the map is damaged)")
    if set(map(type, blobs)) != {bytes} or set(map(len, blobs)) != {4 * dimension}:
        raise MapError(f"expected embeddings of {4 * dimension} bytes (got others: the map is damaged)")
    embeddings = np.frombuffer(b"".join(blobs), dtype="<f4").reshape(-1, dimension)
    try:
        positions = np.stack([np.array(axis, dtype=np.float64) for axis in (x, y, z)], axis=1)
    except (TypeError, ValueError):
        raise MapError("expected positions of three numbers (got others: the map is damaged)") from None
    if not (np.isfinite(embeddings).all() and np.isfinite(positions).all()):
        raise MapError("expected finite positions and embeddings (got NaN or infinity: the map is damaged)")
    return PlaceRows(ids, positions, embeddings.astype(np.float32, copy=False))


def pack_graph(graph: SceneGraph, frame_id: str) -> PackedGraph:
    """Pack a scene graph for storage, without a query place; floats as the wire rounds them.

    Raises:
        MapError: it could not be read back.

    """
    update = msgspec.structs.replace(graph.to_update(seq=0, stamp_ns=0, frame_id=frame_id), query_place=None)
    try:
        data = encode(update)
        decode_update(data, max_bytes=MAX_GRAPH_BYTES)
    except MessageError as error:
        raise MapError(f"expected a scene graph that can be stored (got: {error})") from error
    compressed = zlib.compress(data)
    if len(data) > MOST_PACKED * len(compressed):
        compressed = zlib.compress(data, 0)
    return PackedGraph(hashlib.sha256(data).hexdigest(), len(data), compressed)


def unpack_graph(packed: PackedGraph) -> SceneGraph:
    """Unpack a stored scene graph; memory is bounded by the size it declares, and that by `MOST_PACKED`.

    Raises:
        MapError: it is not what was stored.

    """
    if not 0 < packed.size <= MAX_GRAPH_BYTES:
        raise MapError(f"expected a scene graph of 1 to {MAX_GRAPH_BYTES} bytes (got {packed.size})")
    least = -(-packed.size // MOST_PACKED)
    if len(packed.data) < least:
        raise MapError(f"expected {packed.size} bytes of scene graph in {least} or more (got {len(packed.data)})")
    try:
        stream = zlib.decompressobj()
        data = stream.decompress(packed.data, packed.size)
        if hashlib.sha256(data).hexdigest() != packed.digest:
            raise MapError("expected the scene graph that was stored (got a damaged one)")
        graph = SceneGraph()
        graph.apply(decode_update(data, max_bytes=MAX_GRAPH_BYTES))
    except (zlib.error, MessageError, GraphError) as error:
        raise MapError(f"expected the scene graph that was stored (got a damaged one: {error})") from error
    return graph


def building_digest(places: PlaceRows, frame_id: str, graph_digest: str, history: bytes = b"") -> str:
    """sha256 (hex) of a building's content, whatever order it was added in; without a history as in format 1."""
    head = json.dumps([frame_id, graph_digest, list(places.embeddings.shape), places.ids])
    digest = hashlib.sha256(head.encode())
    digest.update(places.positions.astype("<f8", copy=False).tobytes())
    digest.update(places.embeddings.astype("<f4", copy=False).tobytes())
    digest.update(history)
    return digest.hexdigest()


def content_hash(model_hash: str, labelspace_hash: str, buildings: Iterable[tuple[str, str]]) -> str:
    """sha256 (hex) of a map's content: model, labelspace, and each building's name and digest."""
    text = json.dumps([model_hash, labelspace_hash, sorted(buildings)])
    return hashlib.sha256(text.encode()).hexdigest()
