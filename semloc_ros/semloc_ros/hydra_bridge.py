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
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String

from semloc_core.errors import SemlocError
from semloc_core.graph import GraphDeltas, Labelspace, SceneGraph, load_labelspace
from semloc_core.sources import AgentPose, HydraFile, from_spark_dsg
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
        self._graph: SceneGraph | None = None
        self._agents: dict[str, AgentPose] = {}
        self._number = 0
        self.dropped: dict[str, int] = {}
        """What of the latest message could not be used: reason -> how many nodes and edges."""

    def update(
        self,
        contents: bytes,
        full: bool,
        stamp_ns: int,
        frame_id: str,
        deleted_nodes: Iterable[int] = (),
        deleted_edges: Iterable[int] = (),
        number: int = 0,
    ) -> SceneGraphUpdate | None:
        """Take a message in.

        Args:
            contents: spark_dsg's binary form.
            full: it is the whole graph; else what is new in it, and the rest stays as it is. Hydra itself sends
                nothing but whole graphs.
            stamp_ns: of the message.
            frame_id: of the positions.
            deleted_nodes: ids of nodes that are gone, where it is not the whole graph.
            deleted_edges: likewise; the ends of one edge after those of the other.
            number: counts messages; 0 where the sender does not count.

        Returns:
            The update to publish; None while there is no whole graph yet.

        Raises:
            SemlocError: spark_dsg can't read it, it does not fit the graph, or one before it was lost: there is no
                graph until the next whole one.

        """
        known, last = self._graph, self._number
        if not full and known is None:
            return None
        self._graph, self._number = None, number  # for good, if anything below fails
        if not full and number and number != last + 1:
            raise SemlocError(f"expected change {last + 1} of the scene graph (got {number}): waiting for a whole one")
        part = self._read(contents)
        self.dropped = part.dropped
        agents = {agent.id: agent for agent in part.agents}
        if full or known is None:
            self._graph, self._agents = part.graph, agents
        else:
            gone = [str(node) for node in deleted_nodes]
            ends = [str(node) for node in deleted_edges]
            self._graph = amended(known, part.graph, gone, list(zip(ends[::2], ends[1::2], strict=False)))
            self._agents = {i: a for i, a in self._agents.items() if i not in gone} | agents
        before = self._full_ns
        due = before is None or not before <= stamp_ns < before + self._full_every_ns
        if due:
            self._full_ns = stamp_ns
        return self._deltas.update(self._graph, stamp_ns, frame_id, query_place(self._graph, self._agents), full=due)

    def _read(self, contents: bytes) -> HydraFile:
        import spark_dsg

        try:
            graph = spark_dsg.DynamicSceneGraph.from_binary(contents)
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            reason = " ".join(str(error).split())
            raise SemlocError(f"expected a scene graph in spark_dsg's binary form (got: {reason})") from error
        return from_spark_dsg(graph, self._labelspace)


def amended(
    graph: SceneGraph, part: SceneGraph, gone_nodes: list[str], gone_edges: list[tuple[str, str]]
) -> SceneGraph:
    """A graph with a part of it new, and some of it gone; the graph given is left as it is.

    Raises:
        GraphError: the part does not fit.

    """
    whole = SceneGraph.from_update(graph.to_update(0, 0, ""))
    change = part.to_update(0, 0, "")
    fields = {name: getattr(change, name) for name in change.__struct_fields__}
    news = fields | {"full": False, "removed_nodes": gone_nodes, "removed_edges": gone_edges}
    whole.apply(SceneGraphUpdate(**news))
    return whole


def query_place(graph: SceneGraph, agents: Mapping[str, AgentPose]) -> str | None:
    """The place of the latest agent pose: as the graph says, else the nearest one; None without poses or places."""
    if not agents or not graph.places:
        return None
    latest = max(agents.values(), key=lambda pose: (pose.stamp_ns, int(pose.id)))
    if latest.place is not None and latest.place in graph.places:
        return latest.place
    x, y, z = latest.position
    return min(
        graph.places.items(),
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
        self._waiting: deque[Any] = deque()
        self._dropped: dict[str, int] = {}
        logging.getLogger("semloc_core.sources.hydra").setLevel(logging.ERROR)  # what is dropped is said below, once
        self._publisher = self.create_publisher(String, "scene_graph", qos.UPDATES)
        # Messages are taken in while one is worked on, so that of whole graphs only the latest waits.
        self._there_is_work = self.create_guard_condition(self._work, MutuallyExclusiveCallbackGroup())
        self.create_subscription(message_type, "dsg", self._on_dsg, qos.LATEST)

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
        stamp = message.header.stamp
        try:
            update = self._stream.update(
                bytes(message.layer_contents),
                message.full_update,
                stamp.sec * conversions.NS_PER_S + stamp.nanosec,
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
