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
"""`ros2 run semloc_ros hydra_bridge`: what Hydra publishes, as scene-graph updates.

Needs ``hydra_msgs`` and ``spark_dsg``; only `main` imports them, so that the rest of the package does without.
"""

from __future__ import annotations

import sys
import time
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from rclpy.node import Node
from std_msgs.msg import String

from semloc_core.errors import SemlocError
from semloc_core.graph_delta import GraphDeltas
from semloc_core.hydra import HydraFile, from_spark_dsg
from semloc_core.labelspace import Labelspace, load_labelspace
from semloc_core.wire import SceneGraphUpdate
from semloc_ros import conversions, qos
from semloc_ros.parameters import declare, read
from semloc_ros.running import run


class BridgeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the bridge."""

    labelspace: Annotated[
        str, Meta(description="names for class ids: a shipped labelspace or a YAML file; empty: the graph's own")
    ] = ""
    full_every_s: Annotated[float, Meta(ge=0.0, le=3600.0, description="seconds between full updates")] = 5.0


class DsgStream:
    """Hydra's messages to updates. No ROS here.

    Args:
        labelspace: names for class ids where the graph has none.
        full_every_s: seconds between full updates, by the messages' stamps.

    """

    def __init__(self, labelspace: Labelspace | None, full_every_s: float) -> None:
        self._labelspace = labelspace
        self._full_every_ns = round(full_every_s * 1e9)
        self._deltas = GraphDeltas()
        self._full_ns: int | None = None
        self._graph: Any = None

    def update(self, contents: bytes, full: bool, stamp_ns: int, frame_id: str) -> SceneGraphUpdate | None:
        """Take a message in.

        Args:
            contents: spark_dsg's binary form.
            full: it is a whole graph; else a change of the one before.
            stamp_ns: of the message.
            frame_id: of the positions.

        Returns:
            The update to publish; None while there is no whole graph yet.

        Raises:
            SemlocError: spark_dsg can't read it.

        """
        import spark_dsg

        try:
            if full or self._graph is None:
                if not full:
                    return None
                self._graph = spark_dsg.DynamicSceneGraph.from_binary(contents)
            else:
                self._graph.update_from_binary(contents)
        except (RuntimeError, ValueError) as error:
            self._graph = None  # until the next whole one
            raise SemlocError(f"expected a scene graph in spark_dsg's binary form (got: {error})") from error
        file = from_spark_dsg(self._graph, self._labelspace)
        last = self._full_ns
        due = last is None or not last <= stamp_ns < last + self._full_every_ns
        if due:
            self._full_ns = stamp_ns
        return self._deltas.update(file.graph, stamp_ns, frame_id, query_place(file), full=due)


def query_place(file: HydraFile) -> str | None:
    """The place of the latest agent pose: as the graph says, else the nearest one; None without poses or places."""
    if not file.agents or not file.graph.places:
        return None
    latest = file.agents[-1]
    if latest.place is not None and latest.place in file.graph.places:
        return latest.place
    x, y, z = latest.position
    return min(
        file.graph.places.items(),
        key=lambda item: ((item[1][0] - x) ** 2 + (item[1][1] - y) ** 2 + (item[1][2] - z) ** 2, item[0]),
    )[0]


class Bridge(Node):
    """Subscribes ``dsg`` (remap it to Hydra's topic), publishes ``scene_graph``."""

    def __init__(self, message_type: Any, **kwargs: Any) -> None:
        super().__init__("hydra_bridge", **kwargs)
        declare(self, BridgeConfig, BridgeConfig.__struct_fields__)
        config: BridgeConfig = read(self, BridgeConfig)
        space = load_labelspace(config.labelspace) if config.labelspace else None
        self._stream = DsgStream(space, config.full_every_s)
        self._publisher = self.create_publisher(String, "scene_graph", qos.UPDATES)
        self.create_subscription(message_type, "dsg", self._on_dsg, qos.LATEST)

    def _on_dsg(self, message: Any) -> None:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * conversions.NS_PER_S + stamp.nanosec
        started = time.monotonic()
        try:
            update = self._stream.update(
                bytes(message.layer_contents), message.full_update, stamp_ns, message.header.frame_id
            )
        except SemlocError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        if update is not None:
            self._publisher.publish(conversions.string(update))
            self.get_logger().debug(f"update {update.seq} in {1e3 * (time.monotonic() - started):.0f} ms")


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
