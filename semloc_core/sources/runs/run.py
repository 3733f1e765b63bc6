"""A run on disk: scene-graph updates and, for evaluation only, the robot's true poses. What is a run is told here.

A run is a bag with updates as JSON text or as Hydra publishes them (`hydra_msgs/DsgUpdate`), or with 3D detections and
what says where the robot was; or a file of JSON text, an update a line.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from semloc_core import wire
from semloc_core.errors import BagError, MessageError
from semloc_core.files import GRAPH
from semloc_core.files import kind_of as what_is
from semloc_core.graph import Reading
from semloc_core.sources.bag import (
    GROUND_TRUTH_TOPIC,
    POINT_STAMPED,
    POSE_STAMPED,
    SCENE_GRAPH_TOPIC,
    STRING,
    BagMessage,
    BagReader,
    Truth,
    decode_point,
    decode_pose,
    decode_string,
)
from semloc_core.sources.bag.kinds import kind_of, unpacked
from semloc_core.sources.bag.typed import DETECTIONS, GRID, ODOMETRY, TRANSFORMS, TypedMessages
from semloc_core.sources.runs.hydra_messages import DSG_UPDATE, HydraMessages
from semloc_core.sources.runs.kind import is_run, robots_of, topics_of, with_updates
from semloc_core.text import short_repr
from semloc_core.wire import SceneGraphUpdate

if TYPE_CHECKING:
    from semloc_core.sources.detections.stream import StreamConfig

_LOG = logging.getLogger(__name__)
_TRUTHS: dict[str, Callable[[bytes], Truth]] = {POINT_STAMPED: decode_point, POSE_STAMPED: decode_pose}


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
            raise BagError(f"expected a run: a bag, or JSON text with an update a line (got {self._what()})")
        if self.path.is_dir() or self._is_bag():
            self._types = topics_of(self.path)
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

    def _what(self) -> str:
        """What a file is that is no run."""
        kind = what_is(self.path)
        return f"{self.path}, which is {kind}{'; semloc bag simulate walks through one' if kind == GRAPH else ''}"

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
        hydra = None
        if self._types[self.topic] == DSG_UPDATE:
            about = self.path, self.topic, self.passed_over
            hydra = HydraMessages(*about, reader, self._reading, self._robot)
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
                    stamp_ns = max(stamp_of(text, stamp_ns), 0)
                    yield RunMessage(stamp_ns, text)

    def _pick(self, robot: str | None) -> str:
        """The topic of the updates: the usual one, or else the only one that has any."""
        if robot is None and self._types.get(SCENE_GRAPH_TOPIC) == STRING:
            return SCENE_GRAPH_TOPIC
        fitting = sorted(with_updates(self.path, [t for t, type_ in self._types.items() if type_ == STRING]))
        if not fitting:
            found = sorted(t for t, type_ in self._types.items() if type_ == DSG_UPDATE)
            # Hydra's frontend publishes what its backend has not yet corrected.
            fitting = [t for t in found if "frontend" not in t.split("/")] or found
            if not fitting and (found := sorted(t for t, type_ in self._types.items() if type_ == DETECTIONS)):
                return next((t for t in found if robot is not None and robot in t.split("/")), found[0])
        if not self._types and _is_cut_off(self.path):
            raise BagError(f"expected a bag with messages (got {self.path}, cut off before its first chunk ends)")
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
        if self._types.get(topic) not in (STRING, DSG_UPDATE, DETECTIONS):
            got = self._types.get(topic, "no such topic")
            raise BagError(
                f"expected {DETECTIONS}, or {STRING} or {DSG_UPDATE} with scene-graph updates on {topic} "
                f"in {self.path} (got {got}; {self._listed()})"
            )

    def _beside(self, topic: str) -> str | None:
        """The topic of true poses that goes with the updates'."""
        spaces = topic.split("/")[:-1]
        names = ["/".join([*spaces[:n], "ground_truth"]) for n in range(len(spaces), 0, -1)]
        return next((name for name in names if self._types.get(name) in _TRUTHS), None)

    def _listed(self) -> str:
        return "topics: " + (", ".join(f"{t} ({type_})" for t, type_ in sorted(self._types.items())) or "nothing")


def _is_cut_off(bag: Path) -> bool:
    reader = BagReader(bag, (), quiet=True)
    for _ in reader:
        pass
    return reader.truncated


def decode_truth(message: BagMessage) -> Truth:
    """The true pose, or position, that a bag's message holds.

    Raises:
        BagError: it is of another type, or broken.

    """
    if message.type not in _TRUTHS:
        raise BagError(f"expected {POSE_STAMPED} or {POINT_STAMPED} on {message.topic} (got {message.type})")
    return _TRUTHS[message.type](message.data)


class _Stamped(msgspec.Struct):
    stamp_ns: wire.Int64


_STAMP = msgspec.json.Decoder(_Stamped)


def stamp_of(text: str, received_ns: int) -> int:
    """An update's own stamp, ns; when it was received where it has none."""
    try:
        return _STAMP.decode(text).stamp_ns
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return received_ns
