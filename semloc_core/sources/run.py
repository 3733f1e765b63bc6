"""A run on disk: a bag with scene-graph updates and, for evaluation only, the robot's true positions."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple, Protocol

import msgspec

from semloc_core import wire
from semloc_core.errors import BagError, GraphError, MessageError
from semloc_core.graph import Outcome, SceneGraph, UpdateStream
from semloc_core.sources.bag import (
    GROUND_TRUTH_TOPIC,
    POINT_STAMPED,
    SCENE_GRAPH_TOPIC,
    STRING,
    BagReader,
    BagWriter,
    Compression,
    StampedPoint,
    decode_point,
    decode_string,
)
from semloc_core.wire import Position, SceneGraphUpdate

_LOG = logging.getLogger(__name__)
_WAITING = 32
"""Updates, or true positions, that wait for their counterpart at most."""


def is_run(path: str | Path) -> bool:
    """Whether an input is a bag rather than a graph file, by its name."""
    return Path(path).suffix == ".mcap" or Path(path).is_dir()


class RecordedStep(Protocol):
    """What `write_run` takes: an update and where the robot truly was, metres."""

    @property
    def update(self) -> SceneGraphUpdate:
        """What the robot published."""

    @property
    def position(self) -> Position:
        """Its true position in the update's frame."""


class RunItem(NamedTuple):
    """One update of a run, as text (it may be malformed).

    Attributes:
        stamp_ns: the update's own stamp; when it was received, where it has none.
        received_ns: when it was received.
        text: the JSON.
        truth: the true position of the same stamp, where there is one.

    """

    stamp_ns: int
    received_ns: int
    text: str
    truth: StampedPoint | None


class _Stamped(msgspec.Struct):
    stamp_ns: wire.Int64


_STAMP = msgspec.json.Decoder(_Stamped)


def write_run(path: str | Path, steps: Iterable[RecordedStep], *, compression: Compression = "none") -> int:
    """Record a run.

    Args:
        path: a ``.mcap`` file, or a rosbag2 folder.
        steps: updates and true positions in order; consumed as they come.
        compression: of the bag's chunks.

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
            bag.write_point(GROUND_TRUTH_TOPIC, stamp_ns, step.update.frame_id, step.position)
            count += 1
    return count


def read_run(
    path: str | Path, *, topic: str = SCENE_GRAPH_TOPIC, truth_topic: str = GROUND_TRUTH_TOPIC
) -> Iterator[RunItem]:
    """Updates of a run in order, each with the true position of the same stamp, in bounded memory.

    An update is held back until its true position has come, a later one has, or too many wait.

    Raises:
        BagError: the bag can't be read, or has no updates on ``topic``.

    """
    waiting: deque[RunItem] = deque()
    truths: dict[int, StampedPoint] = {}
    latest, found = -1, False

    def due() -> Iterator[RunItem]:
        while waiting and (waiting[0].stamp_ns in truths or latest > waiting[0].stamp_ns or len(waiting) > _WAITING):
            item = waiting.popleft()
            yield item._replace(truth=truths.pop(item.stamp_ns, None))

    reader = BagReader(path, {topic: STRING, truth_topic: POINT_STAMPED})
    for message in reader:
        if message.topic == truth_topic:
            truth = decode_point(message.data)
            truths[truth.stamp_ns] = truth
            latest = truth.stamp_ns
            if len(truths) > _WAITING:
                del truths[next(iter(truths))]
        else:
            found = True
            text = decode_string(message.data)
            waiting.append(RunItem(_stamp_of(text, message.stamp_ns), message.stamp_ns, text, None))
        yield from due()
    if not found:
        topics = ", ".join(sorted(reader.types)) or "nothing"
        raise BagError(f"expected scene-graph updates on {topic} in {path} (got {topics})")
    for item in waiting:
        yield item._replace(truth=truths.pop(item.stamp_ns, None))


def _stamp_of(text: str, received_ns: int) -> int:
    try:
        return _STAMP.decode(text).stamp_ns
    except msgspec.DecodeError:
        return received_ns


def graph_at_end(path: str | Path, *, topic: str = SCENE_GRAPH_TOPIC) -> SceneGraph:
    """The scene graph that a run's updates lead to: what a map is built from.

    Malformed updates are left out, as the localiser does, and logged. If updates are missing and no full one
    follows, it is the graph from before the gap.

    Raises:
        BagError: the bag can't be read, or no update of it could be applied.

    """
    stream = UpdateStream()
    graph: SceneGraph | None = None
    reader = BagReader(path, {topic: STRING})
    for message in reader:
        try:
            outcome, _ = stream.apply(wire.decode_update(decode_string(message.data)))
        except (MessageError, GraphError) as error:
            _LOG.warning("%s: an update at %d ns is left out: %s", path, message.stamp_ns, error)
            continue
        if outcome is Outcome.GAP:
            _LOG.warning("%s: updates before the one at %d ns are missing", path, message.stamp_ns)
        graph = stream.graph or graph
    if graph is None:
        topics = ", ".join(sorted(reader.types)) or "nothing"
        raise BagError(f"expected a full scene-graph update on {topic} in {path} (got none; topics: {topics})")
    return graph
