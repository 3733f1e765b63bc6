"""What goes into a server's rows and comes out of them; nothing that comes out is believed.

Whoever may write to the server, or sits between, can put anything there: sizes are bounded before memory is taken,
types and numbers are checked, and a building's content must have the digest that its row in the catalogue names. (A
digest binds content together; it does not prove who wrote it.)
"""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.errors import MapError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.source import BuildingEntry
from semloc_core.map_database import (
    MAX_BLOB_BYTES,
    MAX_GRAPH_BYTES,
    MAX_HISTORY_BYTES,
    ClassChange,
    PlaceRows,
    StoredBuilding,
    building_digest,
    check_name,
    unpack_history,
)

FORMAT_VERSION = 1
OBJECTS = "objects"
"""Kind of the blob with a building's objects, for `fleet.object_votes`: maps written before it was have none."""
MAX_PLACES = 10_000_000  # of a building
_MAX_DATA_BYTES = 2**20  # of a catalogue row, unpacked

Hash = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Text = Annotated[str, Meta(max_length=1024)]
Row = dict[str, Any]


class Pointer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A building's row in the catalogue, beside its generation.

    Args:
        name: of the building.
        model: hash of the model that made the embeddings.
        digest: of the content, as in a map file.
        n_places: how many places.
        frame_id: see `StoredBuilding`.
        source: likewise.
        stamp_ns: likewise.
        graph_digest: sha256 of the scene graph, unpacked.
        graph_bytes: its size, unpacked.
        graph_packed: its size, packed.
        history_bytes: size of the history.
        changes: the history's class changes.
        removed: there is no such building any more; the rest means nothing then.

    """

    name: Text
    model: Hash
    digest: Hash
    n_places: Annotated[int, Meta(ge=1, le=MAX_PLACES)]
    frame_id: Text
    source: Text
    stamp_ns: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)] | None
    graph_digest: Hash
    graph_bytes: Annotated[int, Meta(ge=1, le=MAX_GRAPH_BYTES)]
    graph_packed: Annotated[int, Meta(ge=1, le=MAX_BLOB_BYTES)]
    history_bytes: Annotated[int, Meta(ge=0, le=MAX_HISTORY_BYTES)] = 0
    changes: dict[str, ClassChange] = {}
    removed: bool = False

    @classmethod
    def of(cls, stored: StoredBuilding, places: PlaceRows, model_hash: str, *, removed: bool = False) -> Pointer:
        """The row of a building."""
        return cls(
            name=stored.name,
            model=model_hash,
            digest=building_digest(places, stored.frame_id, stored.graph.digest, stored.history),
            n_places=len(places.ids),
            frame_id=stored.frame_id,
            source=stored.source,
            stamp_ns=stored.stamp_ns,
            graph_digest=stored.graph.digest,
            graph_bytes=stored.graph.size,
            graph_packed=len(stored.graph.data),
            history_bytes=len(stored.history),
            changes=unpack_history(stored.history).classes,
            removed=removed,
        )

    def entry(self, generation: int) -> BuildingEntry:
        """As a `Catalogue` has it."""
        return BuildingEntry(str(generation), self.digest, self.n_places, self.changes)


class MapRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The map's own row in the catalogue; its generation is that of the model."""

    format: int
    model_hash: Hash
    model_name: Text
    model_bytes: Annotated[int, Meta(ge=1, le=MAX_BLOB_BYTES)]
    labelspace_hash: Hash
    labelspace_name: Text
    dimension: Annotated[int, Meta(ge=1, le=32_768)]


T = TypeVar("T", Pointer, MapRow)


def pack(record: Pointer | MapRow) -> str:
    """A catalogue row's data.

    Raises:
        MapError: too much for a text field.

    """
    text = base64.b64encode(zlib.compress(msgspec.json.encode(record, order="sorted"))).decode()
    if len(text) > layout.MAX_TEXT:
        raise MapError(f"expected what is said of a building in {layout.MAX_TEXT} bytes (got {len(text)})")
    return text


def unpack(data: object, type_: type[T]) -> T:
    """Read what `pack` wrote.

    Raises:
        MapError: something else.

    """
    if not isinstance(data, str) or len(data) > layout.MAX_TEXT:
        raise MapError("expected a row of the catalogue (got something else: the map is damaged)")
    try:
        stream = zlib.decompressobj()
        text = stream.decompress(base64.b64decode(data, validate=True), _MAX_DATA_BYTES)
        record = msgspec.json.decode(text, type=type_)
    except (binascii.Error, ValueError, zlib.error, msgspec.MsgspecError) as error:
        raise MapError(f"expected a row of the catalogue (got a damaged one: {error})") from error
    if isinstance(record, MapRow) and record.format != FORMAT_VERSION:
        raise MapError(f"expected a map of format {FORMAT_VERSION} (got {record.format})")
    if isinstance(record, Pointer):
        check_name("a building name", record.name)
        check_name("a frame", record.frame_id)
    return record


def integer(row: Mapping[str, Any], field: str) -> int:
    """A whole number of a row that came from a server."""
    value = row.get(field)
    if not isinstance(value, int) or isinstance(value, bool):
        raise MapError(f"expected a whole number as {field} (got {type(value).__name__}: the map is damaged)")
    return value


def text(row: Mapping[str, Any], field: str) -> str:
    """A text of a row that came from a server."""
    value = row.get(field)
    if not isinstance(value, str):
        raise MapError(f"expected a text as {field} (got {type(value).__name__}: the map is damaged)")
    return value


def place_rows(generation: int, places: PlaceRows) -> Iterator[Row]:
    """A building's places as rows."""
    columns = zip(places.ids, places.positions.tolist(), places.embeddings, strict=True)
    for i, (id_, (x, y, z), embedding) in enumerate(columns):
        key = f"{generation}:{i}"
        yield {
            "key": key,
            "generation": generation,
            "row": i,
            "id": id_,
            "x": x,
            "y": y,
            "z": z,
            "embedding": embedding,
        }


def blob_rows(generation: int, kind: str, data: bytes) -> Iterator[Row]:
    """A blob as rows, one a piece."""
    for piece, start in enumerate(range(0, len(data), layout.PIECE_BYTES)):
        part = base64.b64encode(data[start : start + layout.PIECE_BYTES]).decode()
        key = f"{generation}:{kind}:{piece}"
        yield {
            "key": key,
            "generation": generation,
            "kind": kind,
            "piece": piece,
            "data": part,
            "embedding": layout.PAD,
        }


def pieces(size: int) -> int:
    """How many rows a blob of ``size`` bytes takes."""
    return -(-size // layout.PIECE_BYTES)


def one_piece(row: Row) -> bytes:
    """The bytes of a piece of a blob; MapError where it is none."""
    try:
        return base64.b64decode(text(row, "data"), validate=True)
    except (binascii.Error, ValueError):
        raise MapError("expected a piece of a blob in base 64 (got something else: the map is damaged)") from None


def join_pieces(rows: Sequence[Row], first: int, count: int, size: int) -> bytes:
    """Some pieces of a blob, in order.

    Args:
        rows: as the server gives them, in any order; a piece may come twice.
        first: the first piece wanted.
        count: how many.
        size: of the whole blob, bytes.

    Raises:
        MapError: a piece is missing or is something else.

    """
    found = {integer(row, "piece"): row for row in rows}
    if sorted(found) != list(range(first, first + count)):
        raise MissingRowsError(f"expected {count} pieces of a blob (got {len(found)}: the map is damaged)")
    parts = []
    for piece in range(first, first + count):
        part = one_piece(found[piece])
        if len(part) != min(layout.PIECE_BYTES, size - piece * layout.PIECE_BYTES):
            raise MapError(f"expected a blob of {size} bytes (got another size: the map is damaged)")
        parts.append(part)
    return b"".join(parts)


class MissingRowsError(MapError):
    """Rows that a pointer promises are not there: swept since it was read, or lost."""


def join_places(rows: Sequence[Row], first: int, count: int, dimension: int) -> PlaceRows:
    """Some places of a building, in order of their rows.

    Args:
        rows: as the server gives them, in any order; a row may come twice.
        first: the first row wanted.
        count: how many.
        dimension: D.

    Raises:
        MapError: a row is missing, or is not what was written.

    """
    found = {integer(row, "row"): row for row in rows}
    if sorted(found) != list(range(first, first + count)):
        raise MissingRowsError(f"expected {count} places (got {len(found)}: the map is damaged)")
    ordered = [found[i] for i in range(first, first + count)]
    ids = tuple(text(row, "id") for row in ordered)
    try:
        positions = np.array([[row["x"], row["y"], row["z"]] for row in ordered], dtype=np.float64)
        embeddings = np.array([row["embedding"] for row in ordered], dtype=np.float32)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise MapError("expected positions and embeddings of numbers (got others: the map is damaged)") from None
    if positions.shape != (count, 3) or embeddings.shape != (count, dimension):
        raise MapError(f"expected embeddings of {dimension} numbers (got others: the map is damaged)")
    if not (np.isfinite(positions).all() and np.isfinite(embeddings).all()):
        raise MapError("expected finite positions and embeddings (got NaN or infinity: the map is damaged)")
    return PlaceRows(ids, positions, np.ascontiguousarray(embeddings))


def check_building(pointer: Pointer, stored: StoredBuilding, places: PlaceRows) -> None:
    """Refuse a building that is not what its row in the catalogue says.

    Raises:
        MapError: other content, or other class changes than its history has.

    """
    if list(places.ids) != sorted(set(places.ids)):
        raise MapError(f"expected places of {pointer.name!r} by rising id (got others: the map is damaged)")
    digest = building_digest(places, stored.frame_id, stored.graph.digest, stored.history)
    if digest != pointer.digest or unpack_history(stored.history).classes != pointer.changes:
        raise MapError(
            f"expected building {pointer.name!r} as it was committed (got other content: the map is damaged)"
        )
