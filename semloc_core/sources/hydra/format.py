"""The part of Hydra's scene-graph JSON (spark_dsg 1.0 and 1.1) that semloc reads, as types; meshes are skipped."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import msgspec

from semloc_core.errors import FileFormatError
from semloc_core.wire import one_line

MAX_FILE_BYTES = 2 * 2**30
PLACE_TYPES = ("PlaceNodeAttributes", "Place2dNodeAttributes", "TraversabilityNodeAttributes")
OBJECT_TYPES = ("ObjectNodeAttributes", "KhronosObjectAttributes")
AGENT_TYPE = "AgentNodeAttributes"
ROOM_TYPE = "RoomNodeAttributes"
OBJECT_LABELSPACE = "_l2p0"  # layer 2, partition 0

# JSON has no NaN; C++ writes null for it, Python writes what other parsers refuse
_NOT_FINITE = re.compile(rb"(?<=[\s,:\[])-?(?:NaN|Infinity)(?=[\s,\]}])")

Triple = tuple[float | None, float | None, float | None]


class Quaternion(msgspec.Struct):
    """A rotation; null stands for NaN."""

    w: float | None
    x: float | None
    y: float | None
    z: float | None


class Box(msgspec.Struct):
    """A bounding box: ``min`` and ``max`` in 1.0, ``dimensions`` in 1.1."""

    type: str | int = "INVALID"
    dimensions: Triple | None = None
    min: Triple | None = None
    max: Triple | None = None


class Attributes(msgspec.Struct):
    """What of a node's attributes is of use; which there are depends on ``type``."""

    type: str
    position: Triple | None = None
    name: str = ""
    semantic_label: int | None = None
    bounding_box: Box | None = None
    world_R_body: Quaternion | None = None
    timestamp: int | None = None


class Node(msgspec.Struct):
    """A node of any layer. 1.0 keeps an agent's time (ns) beside the attributes, 1.1 in them."""

    id: int
    attributes: Attributes
    timestamp: int | None = None


class Edge(msgspec.Struct):
    """An edge within or between layers."""

    source: int
    target: int


class Version(msgspec.Struct):
    """Of the encoding."""

    major: int
    minor: int


class Header(msgspec.Struct):
    """Absent in 1.0."""

    version: Version


class Metadata(msgspec.Struct):
    """Labelspaces by layer and partition: (id, name) pairs."""

    labelspaces: dict[str, list[tuple[int, str]]] | None = None


class Document(msgspec.Struct, rename={"header": "SPARK_DSG_header"}):
    """A scene-graph file."""

    nodes: list[Node]
    edges: list[Edge]
    header: Header | None = None
    metadata: Metadata | None = None

    def label_names(self) -> Mapping[int, str] | None:
        """The file's own names of object labels, or None where it has none."""
        spaces = self.metadata.labelspaces if self.metadata is not None else None
        return dict(spaces[OBJECT_LABELSPACE]) if spaces and OBJECT_LABELSPACE in spaces else None


_decoder = msgspec.json.Decoder(Document)


def read_document(path: Path) -> Document:
    """Read a scene-graph JSON file.

    Raises:
        FileFormatError: it can't be read, is too large, or is not a scene graph of version 1.

    """
    what = f"expected Hydra scene-graph JSON at {path}"
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FileFormatError(f"{what} of at most {MAX_FILE_BYTES} bytes (got {size})")
        data = path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"{what} (got: {error.strerror})") from error
    if b"NaN" in data or b"Infinity" in data:
        data = _NOT_FINITE.sub(b"null", data)
    try:
        document = _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise FileFormatError(f"{what} (got: {one_line(str(error))})") from error
    if document.header is not None and document.header.version.major != 1:
        version = document.header.version
        raise FileFormatError(f"{what} of version 1 (got {version.major}.{version.minor})")
    for node in document.nodes:
        if not 0 <= node.id < 2**64:
            raise FileFormatError(f"{what} with node ids of 64 bits (got {one_line(str(node.id))})")
    return document
