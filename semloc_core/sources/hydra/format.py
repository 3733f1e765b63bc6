"""The part of Hydra's scene-graph JSON (spark_dsg 1.0 and 1.1) that semloc reads, as types; meshes are skipped."""

from __future__ import annotations

import codecs
import re
from collections import Counter
from pathlib import Path
from typing import TypeVar

import msgspec

from semloc_core.errors import FileFormatError
from semloc_core.files import GRAPH, other_kind
from semloc_core.graph import INDEX_BITS, node_number
from semloc_core.text import short_repr
from semloc_core.wire import one_line

MAX_FILE_BYTES = 2 * 2**30
PLACE_TYPES = ("PlaceNodeAttributes", "Place2dNodeAttributes", "TraversabilityNodeAttributes")
OBJECT_TYPES = ("ObjectNodeAttributes", "KhronosObjectAttributes")
AGENT_TYPE = "AgentNodeAttributes"
ROOM_TYPE = "RoomNodeAttributes"
OBJECT_LABELSPACE = "_l2p0"  # layer 2, partition 0
LARGEST_EXACT = 2**53
"""Integers above this are no longer themselves as floats."""

# JSON has no NaN; C++ writes null for it, Python writes what other parsers refuse
_NOT_FINITE = re.compile(rb"(?<=[\s,:\[])-?(?:NaN|Infinity)(?=[\s,\]}])")
_SYMBOL = re.compile(r"([ -~])\((\d{1,17})\)|([A-Za-z])(\d{1,17})")
_TRAILING = re.compile(r"trailing characters \(byte (\d+)\)")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
T = TypeVar("T")

Triple = tuple[float | None, float | None, float | None]


class Quaternion(msgspec.Struct):
    """A rotation; null stands for NaN."""

    w: float | None = None
    x: float | None = None
    y: float | None = None
    z: float | None = None


class Box(msgspec.Struct):
    """A bounding box: ``min`` and ``max`` in 1.0, ``dimensions`` in 1.1."""

    type: str | int | None = "INVALID"
    dimensions: Triple | None = None
    min: Triple | None = None
    max: Triple | None = None


class Attributes(msgspec.Struct):
    """What of a node's attributes is of use; which there are depends on ``type``."""

    type: str
    position: Triple | None = None
    name: str | None = ""
    semantic_label: int | None = None
    bounding_box: Box | None = None
    world_R_body: Quaternion | None = None
    timestamp: int | None = None


class Node(msgspec.Struct):
    """A node of any layer. 1.0 keeps an agent's time (ns) beside the attributes, 1.1 in them."""

    id: int | float | str
    attributes: Attributes
    timestamp: int | None = None
    layer: int | float | str | None = None
    partition: int | float | str | None = None

    @property
    def number(self) -> int:
        """The id, once `read_document` has seen to it that it is an integer."""
        assert isinstance(self.id, int)
        return self.id


class Edge(msgspec.Struct):
    """An edge within or between layers."""

    source: int | float | str
    target: int | float | str

    @property
    def ends(self) -> tuple[int, int]:
        """The ids, once `read_document` has seen to it that they are integers."""
        assert isinstance(self.source, int)
        assert isinstance(self.target, int)
        return self.source, self.target


class Version(msgspec.Struct):
    """Of the encoding."""

    major: int
    minor: int


class Header(msgspec.Struct):
    """Absent in 1.0."""

    version: Version


class Metadata(msgspec.Struct):
    """Labelspaces by layer and partition: (id, name) pairs, or id -> name."""

    labelspaces: dict[str, list[tuple[int, str | None]] | dict[int, str | None] | None] | None = None


@short_repr
class Document(msgspec.Struct, rename={"header": "SPARK_DSG_header"}):
    """A scene-graph file."""

    nodes: list[Node]
    edges: list[Edge]
    header: Header | None = None
    metadata: Metadata | None = None

    def labelspaces(self) -> dict[str, list[tuple[int, str | None]]]:
        """The file's own names of labels, by ``_l<layer>p<partition>``; without those that are empty."""
        spaces = (self.metadata.labelspaces if self.metadata is not None else None) or {}
        lists = {key: list(rows.items()) if isinstance(rows, dict) else rows for key, rows in spaces.items()}
        return {key: rows for key, rows in lists.items() if rows}


class _Loose(msgspec.Struct, rename={"header": "SPARK_DSG_header"}):
    """A file some of whose nodes or edges are not what they should be: they are read one by one."""

    nodes: list[msgspec.Raw]
    edges: list[msgspec.Raw]
    header: Header | None = None
    metadata: Metadata | None = None


_decoder = msgspec.json.Decoder(Document)
_loose = msgspec.json.Decoder(_Loose, strict=False)
_node = msgspec.json.Decoder(Node, strict=False)
_edge = msgspec.json.Decoder(Edge, strict=False)


def read_document(path: Path, dropped: Counter[str], said: list[str]) -> Document:
    """Read a scene-graph JSON file; ids are integers in what is returned.

    Numbers that stand as text, or with ``.0``, are read as numbers, and symbols (``p(12)``) as the ids they stand for.

    Args:
        path: the file.
        dropped: counts the nodes and edges that can't be read, by reason.
        said: takes lines on what else was passed over.

    Raises:
        FileFormatError: it can't be read, is too large, is not a scene graph of version 1, or not one of its nodes,
            or of its edges, can be read.

    """
    what = f"expected Hydra scene-graph JSON at {path}"
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FileFormatError(f"{what} of at most {MAX_FILE_BYTES} bytes (got {size})")
        data = path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"{what} (got: {error.strerror})") from error
    try:
        data = _utf8(data, said)
        if b"NaN" in data or b"Infinity" in data:
            data = _NOT_FINITE.sub(b"null", data)
        document = _decode(data, dropped, said)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        kind = other_kind(path, GRAPH)
        got = f": {one_line(str(error))}" if kind is None else f" {kind}"
        raise FileFormatError(f"{what} (got{got})") from error
    if document.header is not None and document.header.version.major != 1:
        version = document.header.version
        raise FileFormatError(f"{what} of version 1 (got {version.major}.{version.minor})")
    first = document.nodes[0].id if document.nodes else None
    document.nodes = [node for node in document.nodes if _numbered(node, dropped)]
    if first is not None and not document.nodes:
        raise FileFormatError(f"{what} with node ids of 64 bits (got {one_line(str(first))})")
    document.edges = [edge for edge in document.edges if _joined(edge, dropped)]
    return document


def _utf8(data: bytes, said: list[str]) -> bytes:
    """The text as UTF-8 without a mark."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            said.append(f"a byte order mark of {encoding.upper()} at its start was passed over")
            return data[len(mark) :] if encoding == "utf-8" else data.decode(encoding).encode()
    return data


def _decode(data: bytes, dropped: Counter[str], said: list[str]) -> Document:
    try:
        return _decoder.decode(data)
    except msgspec.ValidationError as error:
        return _decode_loosely(data, dropped, error)
    except msgspec.DecodeError as error:
        found = _TRAILING.search(str(error))
        if found is None:
            raise
    end = int(found[1]) - 1  # msgspec counts from 1
    said.append(f"{len(data) - end} bytes behind the end of the graph were passed over")
    try:
        return _decoder.decode(data[:end])
    except msgspec.ValidationError as error:
        return _decode_loosely(data[:end], dropped, error)


def _decode_loosely(data: bytes, dropped: Counter[str], error: msgspec.ValidationError) -> Document:
    loose = _loose.decode(data)
    nodes = _each(loose.nodes, _node, "node that can't be read", dropped)
    edges = _each(loose.edges, _edge, "edge that can't be read", dropped)
    if (loose.nodes and not nodes) or (loose.edges and not edges):
        raise error
    return Document(nodes, edges, loose.header, loose.metadata)


def _each(rows: list[msgspec.Raw], decoder: msgspec.json.Decoder[T], reason: str, dropped: Counter[str]) -> list[T]:
    read = []
    for row in rows:
        try:
            read.append(decoder.decode(row))
        except (msgspec.DecodeError, UnicodeError, RecursionError):
            dropped[reason] += 1
    return read


def _numbered(node: Node, dropped: Counter[str]) -> bool:
    number = id_number(node.id)
    if number is None:
        dropped["node id that is no 64-bit number"] += 1
        return False
    node.id = number
    return True


def _joined(edge: Edge, dropped: Counter[str]) -> bool:
    source, target = id_number(edge.source), id_number(edge.target)
    if source is None or target is None:
        dropped["edge that can't be read"] += 1
        return False
    edge.source, edge.target = source, target
    return True


def id_number(value: int | float | str) -> int | None:
    """The 64-bit id that a number, its digits, or a symbol as spark_dsg prints it (``p(12)``) means; None: no id."""
    if isinstance(value, str):
        text = value.strip()
        symbol = _SYMBOL.fullmatch(text)
        if symbol is not None:
            prefix, index = (symbol[1], symbol[2]) if symbol[1] else (symbol[3], symbol[4])
            return node_number(prefix, int(index)) if int(index) < 1 << INDEX_BITS else None
        if not (text.isascii() and text.isdigit() and len(text) <= 20):
            return None
        value = int(text)
    if isinstance(value, float):
        # A larger one has lost its last bits: it may be another node's.
        if not (value.is_integer() and abs(value) <= LARGEST_EXACT):
            return None
        value = int(value)
    return value if 0 <= value < 2**64 else None
