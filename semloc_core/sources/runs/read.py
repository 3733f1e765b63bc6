"""A run read: its updates with the true poses beside them, and the graph that they lead to."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from semloc_core import wire
from semloc_core.errors import BagError, GraphError, MessageError
from semloc_core.graph import Outcome, Reading, SceneGraph, UpdateStream, mend
from semloc_core.sources.bag import (
    Truth,
)
from semloc_core.sources.runs.run import Run, stamp_of
from semloc_core.sources.truth import TOLERANCE_S, TruthMatcher
from semloc_core.text import short_repr

if TYPE_CHECKING:
    from semloc_core.sources.detections.stream import StreamConfig

_LOG = logging.getLogger(__name__)
_WAITING = 32
"""Updates that wait for their true pose at most."""


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
        path: a bag (its file or folder), or JSON text.
        topic: of the updates; None: `/scene_graph`, or the only one that has any.
        robot: of several in one file, this one; None: the first.
        truth_topic: of true poses; None: `ground_truth` beside the updates.
        reading: how labels are read; None: as the file has them.
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
            stamp_ns = stamp_of(message.text, message.received_ns)
            due = matcher.item(stamp_ns, RunItem(stamp_ns, message.received_ns, message.text, None))
        for item, truth in due:
            yield item._replace(truth=truth)
    if not found:
        raise BagError(f"expected scene-graph updates in {path} (got none)")
    for item, truth in matcher.rest():
        yield item._replace(truth=truth)


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
