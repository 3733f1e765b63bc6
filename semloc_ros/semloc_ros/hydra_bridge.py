# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""`ros2 run semloc_ros hydra_bridge`: what Hydra publishes (`hydra_msgs/DsgUpdate`), as scene-graph updates.

Needs ``hydra_msgs`` and ``spark_dsg``; only `main` imports them, so that the rest of the package does without.
"""

from __future__ import annotations

import logging
import sys
from collections import deque
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Empty, String

from semloc_core.errors import SemlocError
from semloc_core.graph import Reading
from semloc_core.sources import DsgStream
from semloc_ros import conversions, qos
from semloc_ros.parameters import declare, read
from semloc_ros.running import run


class BridgeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the bridge."""

    labelspace: Annotated[
        str, Meta(description="names for class ids: a shipped labelspace or a YAML file; empty: the graph's own")
    ] = ""
    full_every_s: Annotated[float, Meta(ge=0.0, le=3600.0, description="seconds between full updates")] = 5.0
    robot: Annotated[
        str, Meta(description="the robot whose poses are followed, by its node ids' letter; empty: the first")
    ] = ""


class Bridge(Node):
    """Subscribes ``dsg`` (remap it to Hydra's topic), publishes ``scene_graph``."""

    def __init__(self, message_type: Any, **kwargs: Any) -> None:
        super().__init__("hydra_bridge", **kwargs)
        declare(self, BridgeConfig, BridgeConfig.__struct_fields__)
        config: BridgeConfig = read(self, BridgeConfig)
        reading = Reading.of(config.labelspace or None, None)
        self._stream = DsgStream(reading, config.full_every_s, config.robot or None)
        self._waiting: deque[Any] = deque()
        self._dropped: dict[str, int] = {}
        logging.getLogger("semloc_core.sources.hydra").setLevel(logging.ERROR)  # what is dropped is said below, once
        self._publisher = self.create_publisher(String, "scene_graph", qos.UPDATES)
        # Messages are taken in while one is worked on, so that of whole graphs only the latest waits.
        self._there_is_work = self.create_guard_condition(self._work, MutuallyExclusiveCallbackGroup())
        self.create_subscription(message_type, "dsg", self._on_dsg, qos.LATEST)
        self.create_subscription(Empty, qos.full_request_topic(self), lambda _: self._stream.ask_full(), qos.LATEST)

    def _on_dsg(self, message: Any) -> None:
        if message.full_update:
            self._waiting.clear()
        self._waiting.append(message)
        self._there_is_work.trigger()

    def _work(self) -> None:
        while self._waiting:
            try:
                message = self._waiting.popleft()
            except IndexError:  # a whole graph is just taking its place
                return
            self._convert(message)

    def _convert(self, message: Any) -> None:
        try:
            update = self._stream.update(
                bytes(message.layer_contents),
                message.full_update,
                conversions.stamp_ns(message.header.stamp),
                message.header.frame_id,
                message.deleted_nodes,
                message.deleted_edges,
                message.sequence_number,
            )
            if update is not None:
                self._publisher.publish(conversions.string(update))
        except SemlocError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        if self._stream.dropped != self._dropped:
            self._dropped = self._stream.dropped
            listed = ", ".join(f"{count} × {reason}" for reason, count in self._dropped.items())
            self.get_logger().info(f"dropped of the scene graph: {listed or 'nothing'}")


def main() -> int:
    """Bridge until SIGINT or SIGTERM; 2 where hydra_msgs or spark_dsg is not installed."""
    try:
        import spark_dsg  # noqa: F401  # asked for here, so that its absence is said at once
        from hydra_msgs.msg import DsgUpdate
    except ImportError as error:
        sys.stderr.write(f"expected hydra_msgs and spark_dsg to be installed (got: {error})\n")
        return 2
    return run(lambda: Bridge(DsgUpdate))


if __name__ == "__main__":
    sys.exit(main())
