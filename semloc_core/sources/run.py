"""A run on disk: scene-graph updates and, for evaluation only, the robot's true poses. What is a run is told here.

A run is a bag with updates as JSON text or as Hydra publishes them (`hydra_msgs/DsgUpdate`), or with 3D detections and
what says where the robot was; or a file of JSON text, an update a line.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, islice
from math import cos, sin
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from semloc_core import wire
from semloc_core.errors import BagError, GraphError, MessageError, SemlocError
from semloc_core.graph import Outcome, Reading, SceneGraph, UpdateStream, mend
from semloc_core.sources.bag import (
    GROUND_TRUTH_TOPIC,
    POINT_STAMPED,
    POSE_STAMPED,
    SCENE_GRAPH_TOPIC,
    STRING,
    BagMessage,
    BagReader,
    BagWriter,
    Compression,
    Truth,
    decode_point,
    decode_pose,
    decode_string,
)
from semloc_core.sources.bag.kinds import kind_of, unpacked
from semloc_core.sources.bag.typed import DETECTIONS, GRID, ODOMETRY, TRANSFORMS, TypedMessages
from semloc_core.sources.truth import TOLERANCE_S, TruthMatcher
from semloc_core.text import short_repr
from semloc_core.wire import Position, SceneGraphUpdate

if TYPE_CHECKING:
    from semloc_core.sources.detections.stream import StreamConfig

_LOG = logging.getLogger(__name__)
_WAITING = 32
"""Updates that wait for their true pose at most."""
_LOOKED_AT = 100
"""Messages of a topic that are looked at, to see whether it has updates."""
_DSG_UPDATE = "hydra_msgs/msg/DsgUpdate"
_TRUTHS: dict[str, Callable[[bytes], Truth]] = {POINT_STAMPED: decode_point, POSE_STAMPED: decode_pose}
_SUFFIXES = (".mcap", ".db3", ".jsonl", ".ndjson", ".mcap.zstd", ".db3.zstd")
_SCHEMA = "semloc/scene_graph_update/"
# As Hydra's ROS 2 packages define it; used where a bag has no definition of its own.
_DSG_FIELDS = (
    "std_msgs/Header header\nuint8[] layer_contents\nuint64[] deleted_nodes\nuint64[] deleted_edges\n"
    "bool full_update\nuint64 sequence_number\n"
)


class RecordedStep(Protocol):
    """What `write_run` takes: an update and where the robot truly was."""

    @property
    def update(self) -> SceneGraphUpdate:
        """What the robot published."""

    @property
    def position(self) -> Position:
        """Its true position in the building's frame."""

    @property
    def heading(self) -> float:
        """Its true heading there, radians."""


@short_repr
class RunItem(NamedTuple):
    """One update of a run, as text (it may be malformed).

    Attributes:
        stamp_ns: the update's own stamp; when it was received, where it has none.
        received_ns: when it was received.
        text: the JSON.
        truth: the true pose nearest in time, where there is one within the tolerance.

    """

    stamp_ns: int
    received_ns: int
    text: str
    truth: Truth | None


def write_run(
    path: str | Path,
    steps: Iterable[RecordedStep],
    *,
    compression: Compression = "none",
    truth_frame: str | None = None,
) -> int:
    """Record a run.

    Args:
        path: a ``.mcap`` file, or a rosbag2 folder.
        steps: updates and true poses in order; consumed as they come.
        compression: of the bag's chunks.
        truth_frame: frame of the true poses, the building's; None: that of the updates.

    Returns:
        How many updates were written.

    Raises:
        BagError: the bag can't be written.

    """
    count, steps = 0, iter(steps)
    first = list(islice(steps, 1))  # what can't begin leaves no bag behind
    with BagWriter(path, compression=compression) as bag:
        for step in chain(first, steps):
            stamp_ns = step.update.stamp_ns
            bag.write_string(SCENE_GRAPH_TOPIC, stamp_ns, wire.encode(step.update))
            turn = (0.0, 0.0, sin(step.heading / 2), cos(step.heading / 2))
            frame_id = step.update.frame_id if truth_frame is None else truth_frame
            bag.write_pose(GROUND_TRUTH_TOPIC, stamp_ns, frame_id, step.position, turn)
            count += 1
    return count


def write_updates(path: str | Path, run: Run) -> int:
    """Record what a run's messages make: its updates, and its true poses as they are.

    Args:
        path: a ``.mcap`` file, or a rosbag2 folder.
        run: to be read.

    Returns:
        How many updates were written.

    Raises:
        BagError: the run can't be read or has no updates, or the bag can't be written.

    """
    count, messages = 0, iter(run)
    waiting = []
    for message in messages:  # what can't begin leaves no bag behind
        waiting.append(message)
        if message.text is not None:
            break
    else:
        raise BagError(f"expected detections that make an update in {run.path} (got none)")
    with BagWriter(path) as bag:
        for message in chain(waiting, messages):
            if message.text is not None:
                bag.write_string(SCENE_GRAPH_TOPIC, message.received_ns, message.text)
                count += 1
            elif message.raw is not None:
                bag.write_raw(message.raw)
    return count


@short_repr
class RunMessage(NamedTuple):
    """A message of a run: an update, or a true pose.

    Attributes:
        received_ns: when it was received.
        text: an update's JSON (it may be malformed); None: it is a true pose.
        truth: the true pose.
        raw: the bag's message of the true pose.

    """

    received_ns: int
    text: str | None
    truth: Truth | None = None
    raw: BagMessage | None = None


def is_run(path: Path) -> bool:
    """Whether an input is a run rather than a graph file, by its content; by its name where there is no such file."""
    if path.is_dir() or path.name.endswith(_SUFFIXES):
        return True
    return path.is_file() and (kind_of(path) is not None or _is_update(_first_line(path)))


def _first_line(path: Path) -> bytes:
    with path.open("rb") as file:
        for line in iter(lambda: file.readline(wire.MAX_BYTES), b""):
            if line.strip():
                return line.removeprefix(b"\xef\xbb\xbf")
    return b""


class _Schema(msgspec.Struct):
    schema: str = ""


_SCHEMA_OF = msgspec.json.Decoder(_Schema)


def _is_update(text: bytes | str) -> bool:
    try:
        return _SCHEMA_OF.decode(text).schema.startswith(_SCHEMA)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return False


class Run:
    """A recorded run, open for reading; its messages come in file order, in bounded memory.

    Args:
        path: a bag (see `BagReader`), or JSON text with an update a line; told by content.
        topic: where the updates are; None: ``/scene_graph``, or else the only topic that has updates.
        robot: of several robots' topics, the one of this robot; None: the first's.
        truth_topic: where the true poses are; None: ``/ground_truth``, or ``ground_truth`` beside the updates.
        reading: what Hydra's class numbers are, where its graphs have no names for them.
        truth_only: it needs no updates.
        detections: how a graph is made of detections, where the run has these.

    Attributes:
        topic: the updates'; None in JSON text.
        said: lines for the person on what was chosen.
        passed_over: messages that could not be made an update of, by reason.

    Raises:
        BagError: it can't be read, or no topic, or several, fit.

    """

    def __init__(
        self,
        path: str | Path,
        *,
        topic: str | None = None,
        robot: str | None = None,
        truth_topic: str | None = None,
        reading: Reading | None = None,
        truth_only: bool = False,
        detections: StreamConfig | None = None,
    ) -> None:
        self.path = Path(path)
        self.said: list[str] = []
        self.passed_over: Counter[str] = Counter()
        self._reading = reading
        self._robot = robot
        self._detections = detections
        self.topic: str | None = None
        self._beside_detections: dict[str, str] = {}
        self._truth: str | None = None
        self._types: dict[str, str] = {}
        if not self.path.exists():
            raise BagError(f"expected a run (got {self.path}, which does not exist)")
        if not is_run(self.path):
            raise BagError(f"expected a bag, or JSON text with an update a line (got {self.path}, which is neither)")
        if self.path.is_dir() or self._is_bag():
            self._types = _topics_of(self.path)
            if truth_only and topic is None and GROUND_TRUTH_TOPIC in self._types and robot is None:
                topic = SCENE_GRAPH_TOPIC  # whether it is there or not
                self._types.setdefault(topic, STRING)
            self.topic = topic or self._pick(robot)
            self._check(self.topic)
            if self._types[self.topic] == DETECTIONS:
                self._beside_detections = self._with_detections(topic, robot)
            self._truth = truth_topic or self._beside(self.topic)
            if self._truth is not None and self._types.get(self._truth) not in _TRUTHS:
                raise BagError(
                    f"expected {POSE_STAMPED} or {POINT_STAMPED} on {self._truth} in {self.path} "
                    f"(got {self._types.get(self._truth, 'no such topic')}; {self._listed()})"
                )

    def _is_bag(self) -> bool:
        if (kind := kind_of(self.path)) in ("zstd", "lz4"):
            with unpacked(self.path) as (whole, _):
                return kind_of(whole) is not None
        return kind is not None or self.path.name.endswith((".mcap", ".db3"))

    @property
    def type(self) -> str | None:
        """Type of the messages that updates are, or are made of; None in JSON text."""
        return None if self.topic is None else self._types[self.topic]

    def __iter__(self) -> Iterator[RunMessage]:
        """Updates and true poses.

        Raises:
            BagError: the run is corrupt, or what is needed to read it is not installed.

        """
        if self.topic is None:
            yield from self._from_lines()
            return
        wanted = {self.topic: self._types[self.topic]}
        if self._truth is not None:
            wanted[self._truth] = self._types[self._truth]
        wanted |= self._beside_detections
        reader = BagReader(self.path, wanted)
        if self._types[self.topic] == DETECTIONS:
            yield from self._from_detections(reader)
            return
        hydra = _Hydra(self, reader, self._reading, self._robot) if self._types[self.topic] == _DSG_UPDATE else None
        for message in reader:
            if message.topic == self._truth:
                yield RunMessage(message.stamp_ns, None, decode_truth(message), message)
            elif hydra is None:
                yield RunMessage(message.stamp_ns, decode_string(message.data))
            elif (text := hydra.text(message)) is not None:
                yield RunMessage(message.stamp_ns, text)
        if hydra is not None:
            hydra.finish()

    def _from_detections(self, reader: BagReader) -> Iterator[RunMessage]:
        """The updates that detections make, and true poses."""
        from semloc_core.sources.detections.frames import Frames
        from semloc_core.sources.detections.stream import DetectionStream, StreamConfig, transform_of

        frames, typed = Frames(), TypedMessages(reader)
        stream = DetectionStream(self._detections or StreamConfig(), frames)
        received_ns = 0
        for message in reader:
            received_ns = message.stamp_ns
            if message.topic == self._truth:
                yield RunMessage(message.stamp_ns, None, decode_truth(message), message)
                continue
            updates: Iterable[SceneGraphUpdate] = ()
            try:
                found = typed.decode(message)
                if message.type == DETECTIONS:
                    updates = stream.detections(found)
                elif message.type == ODOMETRY:
                    frames.add(*stream.odometry(found), odometry=True)
                elif message.type == TRANSFORMS:
                    static = message.topic.endswith("static")
                    for one in found.transforms:
                        frames.add(*transform_of(one), static=static)
                else:
                    stream.grid(found)
                for update in chain(updates, stream.poll()):
                    yield RunMessage(received_ns, wire.encode(update).decode())
            except (MessageError, BagError) as error:
                self.passed_over[str(error)] += 1
        for update in stream.poll(end=True):
            yield RunMessage(received_ns, wire.encode(update).decode())
        for reason, count in (self.passed_over + stream.passed_over).items():
            _LOG.warning("%s: passed over %d × %s", self.path, count, reason)

    def _with_detections(self, topic: str | None, robot: str | None) -> dict[str, str]:
        """Topic -> type of what is read beside the first topic of detections: other cameras', poses, a grid."""

        def topics(type_: str, *usual: str) -> list[str]:
            found = sorted(name for name, of in self._types.items() if of == type_)
            if robot is not None:
                found = [name for name in found if robot in name.split("/")] or found
            return next(([name] for name in usual if name in found), found)

        assert self.topic is not None
        wanted = dict.fromkeys([self.topic] if topic else topics(DETECTIONS), DETECTIONS)
        for type_, usual in ((ODOMETRY, ("/odometry", "/odom")), (GRID, ("/grid", "/map"))):
            wanted |= dict.fromkeys(topics(type_, *usual)[:1], type_)
        wanted |= dict.fromkeys(topics(TRANSFORMS), TRANSFORMS)
        if not {ODOMETRY, TRANSFORMS} & {*wanted.values()}:
            raise BagError(f"expected {ODOMETRY} or {TRANSFORMS} beside detections in {self.path} ({self._listed()})")
        self.said.append(f"a graph is made of detections: {', '.join(sorted(wanted))}")
        return wanted

    def _from_lines(self) -> Iterator[RunMessage]:
        stamp_ns = 0
        with unpacked(self.path) as (whole, _), whole.open("rb") as file:
            for line in iter(lambda: file.readline(wire.MAX_BYTES + 2), b""):
                if text := line.decode(errors="replace").lstrip("\ufeff").strip():
                    stamp_ns = max(_stamp_of(text, stamp_ns), 0)
                    yield RunMessage(stamp_ns, text)

    def _pick(self, robot: str | None) -> str:
        """The topic of the updates: the usual one, or else the only one that has any."""
        if robot is None and self._types.get(SCENE_GRAPH_TOPIC) == STRING:
            return SCENE_GRAPH_TOPIC
        fitting = sorted(_with_updates(self.path, [t for t, type_ in self._types.items() if type_ == STRING]))
        if not fitting:
            found = sorted(t for t, type_ in self._types.items() if type_ == _DSG_UPDATE)
            # Hydra's frontend publishes what its backend has not yet corrected.
            fitting = [t for t in found if "frontend" not in t.split("/")] or found
            if not fitting and (found := sorted(t for t, type_ in self._types.items() if type_ == DETECTIONS)):
                return next((t for t in found if robot is not None and robot in t.split("/")), found[0])
        if not fitting:
            raise BagError(f"expected scene-graph updates on {SCENE_GRAPH_TOPIC} in {self.path} (got {self._listed()})")
        names = robots_of(fitting)
        if names is None or len(fitting) == 1:
            if len(fitting) > 1:
                listed = ", ".join(fitting)
                raise BagError(f"expected one topic of updates in {self.path} (got {listed}: --topic chooses one)")
            if fitting[0] != SCENE_GRAPH_TOPIC:
                self.said.append(f"updates are taken from {fitting[0]}, the only topic that has any")
            return fitting[0]
        if robot is not None and robot not in names:
            raise BagError(f"expected one of the robots {', '.join(names)} in {self.path} (got {robot!r})")
        chosen = robot or next(iter(names))
        self._robot = None
        self.said.append(f"{len(names)} robots: {', '.join(names)}; this is {chosen}'s run ({names[chosen]})")
        return names[chosen]

    def _check(self, topic: str) -> None:
        if self._types.get(topic) not in (STRING, _DSG_UPDATE, DETECTIONS):
            got = self._types.get(topic, "no such topic")
            raise BagError(
                f"expected {DETECTIONS}, or {STRING} or {_DSG_UPDATE} with scene-graph updates on {topic} "
                f"in {self.path} (got {got}; {self._listed()})"
            )

    def _beside(self, topic: str) -> str | None:
        """The topic of true poses that goes with the updates'."""
        spaces = topic.split("/")[:-1]
        names = ["/".join([*spaces[:n], "ground_truth"]) for n in range(len(spaces), 0, -1)]
        return next((name for name in names if self._types.get(name) in _TRUTHS), None)

    def _listed(self) -> str:
        return "topics: " + (", ".join(f"{t} ({type_})" for t, type_ in sorted(self._types.items())) or "nothing")


def robots_of(topics: list[str]) -> dict[str, str] | None:
    """Robot -> topic, where topics differ in one name of their namespace only; None where they do not.

    The robot of a topic without that namespace is called by its topic.
    """
    parts = [topic.strip("/").split("/") for topic in topics]
    last = {row[-1] for row in parts}
    if len(last) > 1:
        return None
    if len({len(row) for row in parts}) > 1:
        return {"/".join(row[:-1]) or topic: topic for row, topic in zip(parts, topics, strict=True)}
    differing = [n for n in range(len(parts[0])) if len({row[n] for row in parts}) > 1]
    if len(differing) != 1:
        return None
    return {row[differing[0]]: topic for row, topic in zip(parts, topics, strict=True)}


def _topics_of(path: Path) -> dict[str, str]:
    """Topic -> type of all topics of a bag; where an mcap file has its summary, nothing else is read."""
    if path.is_file() and kind_of(path) == "mcap":
        from mcap.reader import make_reader

        try:
            with path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except Exception:
            # No summary, or a broken one: mcap raises errors of its own, struct.error, ValueError and others.
            summary = None
        if summary is not None and summary.channels and summary.statistics is not None:
            counts: Mapping[int, int] = summary.statistics.channel_message_counts
            types = {c.id: summary.schemas.get(c.schema_id) for c in summary.channels.values()}
            return {
                c.topic: (schema.name if (schema := types[c.id]) is not None else "")
                for c in summary.channels.values()
                if counts.get(c.id)
            }
    reader = BagReader(path, (), quiet=True)
    for _ in reader:
        pass
    return reader.types


def _with_updates(path: Path, topics: list[str]) -> list[str]:
    """Those of some topics of text on which updates are."""
    found: list[str] = []
    looked: Counter[str] = Counter()
    if topics:
        for message in BagReader(path, dict.fromkeys(topics, STRING), quiet=True):
            if message.topic not in found and looked[message.topic] < _LOOKED_AT:
                looked[message.topic] += 1
                if _is_update(decode_string(message.data)):
                    found.append(message.topic)
            if all(topic in found or looked[topic] >= _LOOKED_AT for topic in topics):
                break
    return found


class _Hydra:
    """Hydra's messages in a bag, as updates."""

    def __init__(self, run: Run, reader: BagReader, reading: Reading | None, robot: str | None) -> None:
        try:
            import spark_dsg  # noqa: F401  # asked for here, so that its absence is said once
        except ImportError as error:
            raise BagError(
                f"expected the package spark_dsg, to read {_DSG_UPDATE} on {run.topic} in {run.path} "
                "(got none: pip install 'semloc[hydra]')"
            ) from error
        from semloc_core.sources.hydra.stream import DsgStream

        self._run = run
        self._stream = DsgStream(reading, 5.0, robot)
        self._asked = robot
        self._typed = TypedMessages(reader, {_DSG_UPDATE: _DSG_FIELDS})

    def text(self, message: BagMessage) -> str | None:
        """The update that a message makes, as JSON; None where it makes none."""
        try:
            found = self._typed.decode(message)
            update = self._stream.update(
                bytes(found.layer_contents),
                bool(found.full_update),
                found.header.stamp.sec * 1_000_000_000 + found.header.stamp.nanosec,
                found.header.frame_id or "map",
                [int(i) for i in found.deleted_nodes],
                [int(i) for i in found.deleted_edges],
                int(getattr(found, "sequence_number", 0)),
            )
        except SemlocError as error:
            self._run.passed_over["message that is no scene graph"] += 1
            _LOG.warning("%s: a message at %d ns is passed over: %s", self._run.path, message.stamp_ns, error)
            return None
        if update is None:
            self._run.passed_over["change before the first whole graph"] += 1
            return None
        return wire.encode(update).decode()

    def finish(self) -> None:
        """Say what was repaired in the last message's graph, and whose poses were followed."""
        for line in self._stream.said:
            _LOG.warning("%s: %s", self._run.path, line)
        robots = sorted(self._stream.robots)
        if len(robots) > 1:
            _LOG.warning(
                "%s: poses of %d robots, %s; those of %s were followed (--robot chooses another)",
                self._run.path, len(robots), ", ".join(robots), self._asked or robots[0],
            )  # fmt: skip
        for reason, count in self._run.passed_over.items():
            _LOG.warning("%s: passed over %d × %s", self._run.path, count, reason)


def decode_truth(message: BagMessage) -> Truth:
    """The true pose, or position, that a bag's message holds.

    Raises:
        BagError: it is of another type, or broken.

    """
    if message.type not in _TRUTHS:
        raise BagError(f"expected {POSE_STAMPED} or {POINT_STAMPED} on {message.topic} (got {message.type})")
    return _TRUTHS[message.type](message.data)


def read_run(
    path: str | Path,
    *,
    topic: str | None = None,
    robot: str | None = None,
    truth_topic: str | None = None,
    tolerance_s: float = TOLERANCE_S,
    reading: Reading | None = None,
) -> Iterator[RunItem]:
    """Updates of a run in order, each with the true pose nearest in time, in bounded memory.

    Args:
        path, topic, robot, truth_topic, reading: see `Run`.
        tolerance_s: how far apart the stamps of an update and its true pose may be.

    Raises:
        BagError: the run can't be read, or has no updates.

    """
    run = Run(path, topic=topic, robot=robot, truth_topic=truth_topic, reading=reading)
    matcher: TruthMatcher[RunItem] = TruthMatcher(round(tolerance_s * 1e9), _WAITING)
    found = False
    for message in run:
        if message.text is None:
            assert message.truth is not None
            due = matcher.truth(message.truth)
        else:
            found = True
            stamp_ns = _stamp_of(message.text, message.received_ns)
            due = matcher.item(stamp_ns, RunItem(stamp_ns, message.received_ns, message.text, None))
        for item, truth in due:
            yield item._replace(truth=truth)
    if not found:
        raise BagError(f"expected scene-graph updates in {path} (got none)")
    for item, truth in matcher.rest():
        yield item._replace(truth=truth)


class _Stamped(msgspec.Struct):
    stamp_ns: wire.Int64


_STAMP = msgspec.json.Decoder(_Stamped)


def _stamp_of(text: str, received_ns: int) -> int:
    try:
        return _STAMP.decode(text).stamp_ns
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return received_ns


def graph_at_end(
    path: str | Path, *, reading: Reading | None = None, detections: StreamConfig | None = None
) -> SceneGraph:
    """The scene graph that a run's updates lead to: what a map is built from.

    Malformed updates are left out, as the localiser does, and logged. If updates are missing and no full one
    follows, it is the graph from before the gap. Objects without a place are mended, see `semloc_core.graph.repair`.

    Args:
        path: the run.
        reading: says which updates are meant, and what Hydra's class numbers are; labels that are names stay.
        detections: how a graph is made of detections, where the run has these.

    Raises:
        BagError: the run can't be read, or no update of it could be applied.

    """
    stream = UpdateStream()
    graph: SceneGraph | None = None
    asked = reading or Reading()
    run = Run(path, topic=asked.topic, robot=asked.robot, reading=reading, detections=detections)
    for line in run.said:
        _LOG.warning("%s: %s", path, line)
    for message in run:
        if message.text is None:
            continue
        try:
            outcome, _ = stream.apply(wire.decode_update(message.text))
        except (MessageError, GraphError) as error:
            _LOG.warning("%s: an update at %d ns is left out: %s", path, message.received_ns, error)
            continue
        if outcome is Outcome.GAP:
            _LOG.warning("%s: updates before the one at %d ns are missing", path, message.received_ns)
        graph = stream.graph or graph
    if graph is None:
        raise BagError(
            f"expected a full scene-graph update in {path} (got none{f' on {run.topic}' if run.topic else ''})"
        )
    for line in mend(graph):
        _LOG.warning("%s: %s", path, line)
    return graph
