"""Hydra / spark_dsg scene-graph files to a `SceneGraph`: JSON 1.0 and 1.1, binary through spark_dsg."""

from __future__ import annotations

import logging
import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semloc_core.errors import FileFormatError, LabelspaceError
from semloc_core.graph import Labelspace, SceneGraph, labelspace_from_hydra
from semloc_core.sources.hydra.format import (
    AGENT_TYPE,
    OBJECT_TYPES,
    PLACE_TYPES,
    ROOM_TYPE,
    Box,
    Document,
    Node,
    Triple,
    read_document,
)
from semloc_core.sources.hydra.write import Room
from semloc_core.wire import Object, Place, Position, SceneGraphUpdate

FRAME_ID = "map"  # Hydra's; the files do not name theirs
FARTHEST_M = 1e9
UNIT_TOLERANCE = 1e-2

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class AgentPose:
    """Where the robot was.

    Args:
        stamp_ns: integer nanoseconds.
        position: metres.
        orientation_xyzw: unit quaternion.
        id: node id; its top byte tells robots apart.
        place: the place that the file says the robot was at, or None.

    """

    stamp_ns: int
    position: Position
    orientation_xyzw: tuple[float, float, float, float]
    id: str = ""
    place: str | None = None


@dataclass(frozen=True)
class HydraFile:
    """What a file holds.

    Args:
        graph: places, objects, and their edges.
        labelspace: the file's own: the names it brings along, else ``class_<id>`` of the ids that occur.
        agents: poses by rising time.
        rooms: node id -> room.
        dropped: reason -> how many nodes and edges could not be used.
        reversed: edges between layers that ran from child to parent; they are used.
        frame_id: the frame of all positions.

    """

    graph: SceneGraph
    labelspace: Labelspace
    agents: list[AgentPose] = field(default_factory=list)
    rooms: dict[str, Room] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    reversed: int = 0
    frame_id: str = FRAME_ID


def read_hydra(path: str | Path, labelspace: Labelspace | None = None) -> HydraFile:
    """Read a scene-graph file.

    An object's class is the name that the file gives its label (``metadata.labelspaces``); where the file has
    none, or only the placeholder ``class_<id>``, it is the name that ``labelspace`` gives the id, else
    ``class_<id>``. So a labelspace's ids never overrule names: ids mean other things in other files.

    Nodes that stand twice or have no finite position, edges that stand twice, end nowhere or where they begin are
    dropped, counted and logged as a warning.

    Args:
        path: JSON of spark_dsg 1.0 or 1.1; or ``.sparkdsg``, which takes the package spark_dsg.
        labelspace: names for ids where the file has none.

    Raises:
        FileFormatError: it can't be read, is truncated, or is not such a file; one line that names the path.

    """
    path = Path(path)
    if path.suffix == ".sparkdsg":
        return _read_binary(path, labelspace)
    return _convert(read_document(path), path.name, labelspace)


def from_spark_dsg(graph: Any, labelspace: Labelspace | None = None, name: str = "spark_dsg") -> HydraFile:
    """The same from a ``spark_dsg.DynamicSceneGraph`` in memory.

    Args:
        graph: as spark_dsg loads or receives it.
        labelspace: see `read_hydra`.
        name: for messages.

    Raises:
        FileFormatError: see `read_hydra`.

    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.json"
        graph.save(str(path), include_mesh=False)
        return _convert(read_document(path), name, labelspace)


def _read_binary(path: Path, labelspace: Labelspace | None) -> HydraFile:
    try:
        import spark_dsg
    except ImportError as error:
        hint = "it is not installed: pip install 'semloc[hydra]'"
        raise FileFormatError(f"expected the package spark_dsg, to read {path} (got none: {hint})") from error
    try:
        graph = spark_dsg.DynamicSceneGraph.load(str(path))
    except (RuntimeError, ValueError, IndexError, MemoryError) as error:
        reason = " ".join(str(error).split())
        raise FileFormatError(f"expected a binary Hydra scene graph at {path} (got: {reason})") from error
    return from_spark_dsg(graph, labelspace, path.stem)


def _convert(document: Document, name: str, labelspace: Labelspace | None) -> HydraFile:
    dropped: Counter[str] = Counter()
    nodes = _usable_nodes(document, dropped)
    types = {node.attributes.type for node in nodes.values()}
    place_type = next((t for t in PLACE_TYPES if t in types), PLACE_TYPES[0])
    layers = {place_type: "place", AGENT_TYPE: "agent", ROOM_TYPE: "room"} | dict.fromkeys(OBJECT_TYPES, "object")
    kind = {i: layers[n.attributes.type] for i, n in nodes.items() if n.attributes.type in layers}
    links = _Links(document, nodes, kind, dropped)
    try:
        own = labelspace_from_hydra(name, _items(document), _labels(nodes, kind, name))
    except LabelspaceError as error:
        raise FileFormatError(f"{error}, in {name}") from error
    agents = list(_agents(nodes, kind, links, dropped, name))
    agents.sort(key=lambda pose: (pose.stamp_ns, int(pose.id)))
    update = SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=0,
        frame_id=FRAME_ID,
        seq=0,
        full=True,
        places=[Place(str(i), _position(n)) for i, n in nodes.items() if kind.get(i) == "place"],
        objects=list(_objects(nodes, kind, document, labelspace)),
        edges=links.traversability + links.parents,
        query_place=None,
    )
    rooms = {
        str(i): Room(n.attributes.name, _position(n), tuple(sorted(links.places_of_room.get(i, ()))))
        for i, n in nodes.items()
        if kind.get(i) == "room"
    }
    _report(name, dropped, links.reversed)
    graph = SceneGraph.from_update(update)
    return HydraFile(graph, own, agents, rooms, dict(sorted(dropped.items())), links.reversed)


def _usable_nodes(document: Document, dropped: Counter[str]) -> dict[int, Node]:
    nodes: dict[int, Node] = {}
    for node in document.nodes:
        position = node.attributes.position
        if node.id in nodes:
            dropped["duplicate node id"] += 1
        elif position is None:
            dropped["node without a position"] += 1
        elif not _finite(position):
            dropped["non-finite position"] += 1
        elif not all(abs(x) <= FARTHEST_M for x in position if x is not None):
            dropped["position out of range"] += 1
        else:
            nodes[node.id] = node
    return nodes


class _Links:
    """The file's edges, sorted out by the kinds of their ends."""

    def __init__(self, document: Document, nodes: dict[int, Node], kind: dict[int, str], dropped: Counter[str]) -> None:
        self.traversability: list[tuple[str, str]] = []
        self.parents: list[tuple[str, str]] = []
        self.place_of_agent: dict[int, str] = {}
        self.places_of_room: dict[int, list[str]] = {}
        self.reversed = 0
        seen: set[tuple[int, int]] = set()
        for edge in document.edges:
            a, b = edge.source, edge.target
            pair = (a, b) if a < b else (b, a)
            if a == b:
                dropped["self-loop"] += 1
            elif a not in nodes or b not in nodes:
                dropped["dangling edge"] += 1
            elif pair in seen:
                dropped["duplicate edge"] += 1
            else:
                seen.add(pair)
                self._add(a, b, kind)

    def _add(self, a: int, b: int, kind: dict[int, str]) -> None:
        ends = (kind.get(a), kind.get(b))
        if ends in (("object", "place"), ("agent", "place"), ("place", "room")):  # parents come first
            self.reversed += 1
            a, b, ends = b, a, ends[::-1]
        if ends == ("place", "place"):
            self.traversability.append((str(a), str(b)))
        elif ends == ("place", "object"):
            self.parents.append((str(a), str(b)))
        elif ends == ("place", "agent"):
            self.place_of_agent[b] = str(a)
        elif ends == ("room", "place"):
            self.places_of_room.setdefault(a, []).append(str(b))


def _items(document: Document) -> Iterable[tuple[int, str]] | None:
    names = document.label_names()
    return names.items() if names is not None else None


def _labels(nodes: dict[int, Node], kind: dict[int, str], name: str) -> set[int]:
    labels = set()
    for i, node in nodes.items():
        if kind.get(i) == "object":
            if node.attributes.semantic_label is None:
                raise FileFormatError(f"expected a semantic_label of every object in {name} (got none of {i})")
            labels.add(node.attributes.semantic_label)
    return labels


def _objects(
    nodes: dict[int, Node], kind: dict[int, str], document: Document, labelspace: Labelspace | None
) -> Iterator[Object]:
    names = document.label_names() or {}
    for i, node in nodes.items():
        if kind.get(i) == "object":
            label = node.attributes.semantic_label
            assert label is not None
            class_name = placeholder = f"class_{label}"
            if names.get(label, placeholder) != placeholder:
                class_name = names[label]
            elif labelspace is not None:
                class_name = labelspace.name_of(label) or placeholder
            yield Object(str(i), class_name, _position(node), _size(node.attributes.bounding_box))


def _agents(
    nodes: dict[int, Node], kind: dict[int, str], links: _Links, dropped: Counter[str], name: str
) -> Iterator[AgentPose]:
    for i, node in nodes.items():
        if kind.get(i) != "agent":
            continue
        stamp = node.timestamp if node.timestamp is not None else node.attributes.timestamp
        rotation = node.attributes.world_R_body
        if stamp is None or rotation is None:
            raise FileFormatError(f"expected timestamp and world_R_body of every agent in {name} (got none of {i})")
        x, y, z, w = (math.nan if v is None else v for v in (rotation.x, rotation.y, rotation.z, rotation.w))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1) <= UNIT_TOLERANCE:
            dropped["orientation that is no rotation"] += 1
        elif not -(2**63) <= stamp < 2**63:
            dropped["time out of range"] += 1
        else:
            orientation = (x / norm, y / norm, z / norm, w / norm)
            yield AgentPose(stamp, _position(node), orientation, str(i), links.place_of_agent.get(i))


def _finite(values: Triple) -> bool:
    return all(x is not None and math.isfinite(x) for x in values)


def _position(node: Node) -> Position:
    position = node.attributes.position
    assert position is not None
    x, y, z = position
    assert x is not None
    assert y is not None
    assert z is not None
    return x, y, z


def _size(box: Box | None) -> Position | None:
    """Edge lengths in metres; None where the box is missing, invalid or inside out."""
    if box is None or box.type in ("INVALID", 0):
        return None
    lengths: list[float] = []
    if box.dimensions is not None:
        lengths = [x for x in box.dimensions if x is not None]
    elif box.min is not None and box.max is not None:
        ends = zip(box.min, box.max, strict=True)
        lengths = [high - low for low, high in ends if low is not None and high is not None]
    if len(lengths) < 3 or not all(0 <= x <= FARTHEST_M for x in lengths):
        return None
    return lengths[0], lengths[1], lengths[2]


def _report(name: str, dropped: Counter[str], turned: int) -> None:
    if dropped:
        listed = ", ".join(f"{count} × {reason}" for reason, count in sorted(dropped.items()))
        logger.warning("%s: dropped %s; turned round %d reversed edges", name, listed, turned)
    elif turned:
        logger.info("%s: turned round %d reversed edges", name, turned)
