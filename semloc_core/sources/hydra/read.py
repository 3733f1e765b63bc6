"""Hydra / spark_dsg scene-graph files to a `SceneGraph`: JSON 1.0 and 1.1, binary through spark_dsg."""

from __future__ import annotations

import logging
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from semloc_core.errors import FileFormatError, LabelspaceError
from semloc_core.graph import LARGEST_ID, Labelspace, Reading, SceneGraph, mend
from semloc_core.sources.hydra.file import AgentPose, HydraFile
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
from semloc_core.sources.hydra.links import Links
from semloc_core.sources.hydra.write import Room
from semloc_core.wire import Object, Place, Position

FARTHEST_M = 1e9
UNIT_TOLERANCE = 1e-2

logger = logging.getLogger(__name__)


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
    links = Links(document, nodes, kind, dropped)
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
    nodes: dict[int, Node], kind: dict[int, str], links: Links, dropped: Counter[str], name: str
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
