"""Hydra / spark_dsg scene-graph files to a `SceneGraph`: JSON 1.0 and 1.1, binary through spark_dsg."""

from __future__ import annotations

import logging
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semloc_core.errors import ConfigError, FileFormatError, LabelspaceError
from semloc_core.graph import INDEX_BITS, LARGEST_ID, Labelspace, Reading, SceneGraph, mend
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
from semloc_core.sources.hydra.labels import LabelNames
from semloc_core.sources.hydra.write import Room
from semloc_core.text import short_repr
from semloc_core.wire import Object, Place, Position

FRAME_ID = "map"  # Hydra's; the files do not name theirs
FARTHEST_M = 1e9
UNIT_TOLERANCE = 1e-2

logger = logging.getLogger(__name__)


def robot_of(node: str) -> str:
    """The robot that an agent's node id names: the letter in its top byte, or that byte's number."""
    prefix = int(node or 0) >> INDEX_BITS
    return chr(prefix) if 32 < prefix < 127 else str(prefix)


@dataclass(frozen=True)
class AgentPose:
    """Where the robot was.

    Args:
        stamp_ns: integer nanoseconds.
        position: metres.
        orientation_xyzw: unit quaternion; None where the file has none.
        id: node id; its top byte tells robots apart.
        place: the place that the file says the robot was at, or None.

    """

    stamp_ns: int
    position: Position
    orientation_xyzw: tuple[float, float, float, float] | None
    id: str = ""
    place: str | None = None

    @property
    def robot(self) -> str:
        """Whose pose it is: the letter of the id's top byte."""
        return robot_of(self.id)


@short_repr
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
        decided: a line for each thing that had to be decided of its classes (`semloc_core.graph.labels.classes`).
        said: lines for the person on what was repaired, passed over or will hurt, without the file's name.
        frame_id: the frame of all positions.

    """

    graph: SceneGraph
    labelspace: Labelspace
    agents: list[AgentPose] = field(default_factory=list)
    rooms: dict[str, Room] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    reversed: int = 0
    decided: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    frame_id: str = FRAME_ID

    @property
    def robots(self) -> list[str]:
        """The robots whose poses the file has, sorted."""
        return sorted({pose.robot for pose in self.agents})

    def agents_of(self, robot: str | None = None) -> list[AgentPose]:
        """The poses of one robot; None: of the first.

        Raises:
            ConfigError: the file has no poses of that robot.

        """
        robots = self.robots
        if robot is not None and robot not in robots:
            raise ConfigError(
                f"expected a robot that the file has poses of (got {robot!r}; {', '.join(robots) or 'none'})"
            )
        return [pose for pose in self.agents if pose.robot == (robot or robots[0])]


def read_hydra(path: str | Path, labelspace: Labelspace | Reading | None = None) -> HydraFile:
    """Read a scene-graph file.

    An object's class is what `semloc_core.graph.labels.classes` makes of its label and of the name that the file gives
    it (``metadata.labelspaces``); a number that nobody names is ``class_<id>``.

    Nodes and edges that can't be read, nodes that stand twice or have no finite position, edges that stand twice, end
    nowhere or where they begin are dropped and counted. Objects without an edge to a place hang on the nearest one
    within `semloc_core.graph.repair.HANG_M`. What was repaired, passed over or will hurt is logged, a warning each.

    Args:
        path: JSON of spark_dsg 1.0 or 1.1; or ``.sparkdsg``, which takes the package spark_dsg.
        labelspace: what is said of labels besides; a labelspace is a map's or model's, which the file's names overrule.

    Raises:
        FileFormatError: it can't be read, is truncated, or is not such a file; one line that names the path.

    """
    path = Path(path)
    if path.suffix == ".sparkdsg":
        return _read_binary(path, labelspace)
    return told(_convert(path, path.name, labelspace), path.name)


def told(file: HydraFile, name: str) -> HydraFile:
    """Log what is to be said of a file, a line each."""
    if not file.dropped and file.reversed:
        logger.info("%s: turned round %d reversed edges", name, file.reversed)
    for line in file.said:
        logger.warning("%s: %s", name, line)
    return file


def from_spark_dsg(
    graph: Any, labelspace: Labelspace | Reading | None = None, name: str = "spark_dsg", *, whole: bool = True
) -> HydraFile:
    """The same from a ``spark_dsg.DynamicSceneGraph`` in memory.

    Args:
        graph: as spark_dsg loads or receives it.
        labelspace: see `read_hydra`.
        name: for messages.
        whole: it is a whole graph, so that what has no place in it has none; nothing is mended otherwise.

    Returns:
        What it holds; what `HydraFile.said` says is not logged.

    Raises:
        FileFormatError: see `read_hydra`.

    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.json"
        graph.save(str(path), include_mesh=False)
        return _convert(path, name, labelspace, whole=whole)


def _read_binary(path: Path, labelspace: Labelspace | Reading | None) -> HydraFile:
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
    return told(from_spark_dsg(graph, labelspace, path.stem), path.name)


def _convert(path: Path, name: str, labelspace: Labelspace | Reading | None, *, whole: bool = True) -> HydraFile:
    reading = labelspace if isinstance(labelspace, Reading) else Reading(known=labelspace)
    dropped: Counter[str] = Counter()
    said: list[str] = []
    document = read_document(path, dropped, said)
    nodes = _usable_nodes(document, dropped)
    types = {node.attributes.type for node in nodes.values()}
    place_type = next((t for t in PLACE_TYPES if t in types), PLACE_TYPES[0])
    layers = dict.fromkeys(PLACE_TYPES, "other place") | {AGENT_TYPE: "agent", ROOM_TYPE: "room", place_type: "place"}
    layers |= dict.fromkeys(OBJECT_TYPES, "object")
    kind = {i: layers[n.attributes.type] for i, n in nodes.items() if n.attributes.type in layers}
    labels = _labels(nodes, kind, name, dropped)
    names = LabelNames(document, [nodes[i] for i in labels], said)
    classes = reading.labels(names.of_labels)
    links = _Links(document, nodes, kind, dropped)
    try:
        own = names.labelspace(name, set(labels.values()))
    except LabelspaceError as error:
        raise FileFormatError(f"{error}, in {name}") from error
    agents = list(_agents(nodes, kind, links, dropped, name))
    agents.sort(key=lambda pose: (pose.stamp_ns, int(pose.id)))
    if still := sum(pose.orientation_xyzw is None for pose in agents):
        said.append(f"{still} agent pose(s) without a rotation: of these only the position is used")
    graph = SceneGraph.of(
        [Place(str(i), _position(n)) for i, n in nodes.items() if kind.get(i) == "place"],
        [_object(nodes[i], classes.number(label, names.name_of(nodes[i]))) for i, label in labels.items()],
        links.traversability + links.parents,
    )
    rooms = {
        str(i): Room(n.attributes.name or "", _position(n), tuple(sorted(links.places_of_room.get(i, ()))))
        for i, n in nodes.items()
        if kind.get(i) == "room"
    }
    if dropped:
        listed = ", ".join(f"{count} × {reason}" for reason, count in sorted(dropped.items()))
        said.append(f"dropped {listed}; turned round {links.reversed} reversed edges")
    if whole:
        said += mend(graph, links.on_other_places)
    return HydraFile(
        graph,
        own,
        agents,
        rooms,
        dict(sorted(dropped.items())),
        links.reversed,
        decided=tuple(classes.told()),
        said=tuple(said),
    )


def _usable_nodes(document: Document, dropped: Counter[str]) -> dict[int, Node]:
    nodes: dict[int, Node] = {}
    for node in document.nodes:
        position = node.attributes.position
        if node.number in nodes:
            dropped["duplicate node id"] += 1
        elif position is None:
            dropped["node without a position"] += 1
        elif not _finite(position):
            dropped["non-finite position"] += 1
        elif not all(abs(x) <= FARTHEST_M for x in position if x is not None):
            dropped["position out of range"] += 1
        else:
            nodes[node.number] = node
    return nodes


class _Links:
    """The file's edges, sorted out by the kinds of their ends."""

    def __init__(self, document: Document, nodes: dict[int, Node], kind: dict[int, str], dropped: Counter[str]) -> None:
        self.traversability: list[tuple[str, str]] = []
        self.parents: list[tuple[str, str]] = []
        self.place_of_agent: dict[int, str] = {}
        self.places_of_room: dict[int, list[str]] = {}
        self.on_other_places: set[str] = set()
        self.reversed = 0
        seen: set[tuple[int, int]] = set()
        for edge in document.edges:
            a, b = edge.ends
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
        if ends in (
            ("object", "place"),
            ("agent", "place"),
            ("place", "room"),
            ("object", "other place"),
        ):  # parents come first
            self.reversed += 1
            a, b, ends = b, a, ends[::-1]
        if ends == ("place", "place"):
            self.traversability.append((str(a), str(b)))
        elif ends == ("place", "object"):
            self.parents.append((str(a), str(b)))
        elif ends == ("other place", "object"):
            self.on_other_places.add(str(b))
        elif ends == ("place", "agent"):
            self.place_of_agent[b] = str(a)
        elif ends == ("room", "place"):
            self.places_of_room.setdefault(a, []).append(str(b))


def _labels(nodes: dict[int, Node], kind: dict[int, str], name: str, dropped: Counter[str]) -> dict[int, int]:
    """Object -> its label; objects without one are dropped, unless all are."""
    objects = [i for i in nodes if kind.get(i) == "object"]
    found = {i: nodes[i].attributes.semantic_label for i in objects}
    labels = {i: label for i, label in found.items() if label is not None and 0 <= label <= LARGEST_ID}
    if objects and not labels:
        got = "none" if found[objects[0]] is None else found[objects[0]]
        raise FileFormatError(f"expected a semantic_label of every object in {name} (got {got} of {objects[0]})")
    if missing := len(objects) - len(labels):
        dropped["object without a semantic_label"] += missing
        for i in objects:
            if i not in labels:
                del nodes[i]
                del kind[i]
    return labels


def _object(node: Node, class_: str) -> Object:
    return Object(str(node.number), class_, _position(node), _size(node.attributes.bounding_box))


def _agents(
    nodes: dict[int, Node], kind: dict[int, str], links: _Links, dropped: Counter[str], name: str
) -> Iterator[AgentPose]:
    agents = {i: node for i, node in nodes.items() if kind.get(i) == "agent"}
    stamps = {i: n.timestamp if n.timestamp is not None else n.attributes.timestamp for i, n in agents.items()}
    if agents and all(stamp is None for stamp in stamps.values()):
        raise FileFormatError(f"expected a timestamp of every agent in {name} (got none of {next(iter(agents))})")
    for i, node in agents.items():
        stamp, rotation = stamps[i], node.attributes.world_R_body
        orientation, norm = None, 1.0
        parts = (rotation.x, rotation.y, rotation.z, rotation.w) if rotation is not None else ()
        if any(part is not None for part in parts):
            x, y, z, w = (math.nan if v is None else v for v in parts)
            norm = math.sqrt(x * x + y * y + z * z + w * w)
            orientation = (x / norm, y / norm, z / norm, w / norm) if norm > 0 else None
        if stamp is None:
            dropped["agent without a timestamp"] += 1
        elif not abs(norm - 1) <= UNIT_TOLERANCE:
            dropped["orientation that is no rotation"] += 1
        elif not -(2**63) <= stamp < 2**63:
            dropped["time out of range"] += 1
        else:
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
    if box is None or box.type in ("INVALID", 0, None):
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
