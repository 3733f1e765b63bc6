"""Hydra's own messages in a bag, as updates."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path

from semloc_core import wire
from semloc_core.errors import BagError, SemlocError
from semloc_core.graph import Reading
from semloc_core.sources.bag import (
    BagMessage,
    BagReader,
)
from semloc_core.sources.bag.typed import TypedMessages

_LOG = logging.getLogger(__name__)
DSG_UPDATE = "hydra_msgs/msg/DsgUpdate"
# As Hydra's ROS 2 packages define it; used where a bag has no definition of its own.
_DSG_FIELDS = (
    "std_msgs/Header header\nuint8[] layer_contents\nuint64[] deleted_nodes\nuint64[] deleted_edges\n"
    "bool full_update\nuint64 sequence_number\n"
)


class HydraMessages:
    """Hydra's messages in a bag, as updates."""

    def __init__(
        self,
        path: Path,
        topic: str,
        passed_over: Counter[str],
        reader: BagReader,
        reading: Reading | None,
        robot: str | None,
    ) -> None:
        try:
            import spark_dsg  # noqa: F401  # asked for here, so that its absence is said once
        except ImportError as error:
            raise BagError(
                f"expected the package spark_dsg, to read {DSG_UPDATE} on {topic} in {path} "
                "(got none: pip install 'semloc[hydra]')"
            ) from error
        from semloc_core.sources.hydra.stream import DsgStream

        self._path, self._passed_over = path, passed_over
        self._stream = DsgStream(reading, 5.0, robot)
        self._asked = robot
        self._typed = TypedMessages(reader, {DSG_UPDATE: _DSG_FIELDS})

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
            self._passed_over["message that is no scene graph"] += 1
            _LOG.warning("%s: a message at %d ns is passed over: %s", self._path, message.stamp_ns, error)
            return None
        if update is None:
            self._passed_over["change before the first whole graph"] += 1
            return None
        return wire.encode(update).decode()

    def finish(self) -> None:
        """Say what was repaired in the last message's graph, and whose poses were followed."""
        for line in self._stream.said:
            _LOG.warning("%s: %s", self._path, line)
        robots = sorted(self._stream.robots)
        if len(robots) > 1:
            _LOG.warning(
                "%s: poses of %d robots, %s; those of %s were followed (--robot chooses another)",
                self._path, len(robots), ", ".join(robots), self._asked or robots[0],
            )  # fmt: skip
        for reason, count in self._passed_over.items():
            _LOG.warning("%s: passed over %d × %s", self._path, count, reason)
