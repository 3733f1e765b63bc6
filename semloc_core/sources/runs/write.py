"""Runs written: simulated ones, and those that detections make."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain, islice
from math import cos, sin
from pathlib import Path
from typing import Protocol

from semloc_core import wire
from semloc_core.errors import BagError
from semloc_core.sources.bag import (
    GROUND_TRUTH_TOPIC,
    SCENE_GRAPH_TOPIC,
    BagWriter,
    Compression,
)
from semloc_core.sources.runs.run import Run
from semloc_core.wire import Position, SceneGraphUpdate


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
