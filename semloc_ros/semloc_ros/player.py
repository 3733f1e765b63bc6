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
"""`ros2 run semloc_ros scene_graph_player`: walks through a Hydra file and publishes what a robot would see."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from typing import Annotated, Any

import msgspec
import numpy as np
from geometry_msgs.msg import PointStamped
from msgspec import Meta
from rclpy.node import Node
from std_msgs.msg import Empty, String

from semloc_core.errors import FileFormatError
from semloc_core.graph import Reading, SceneGraph
from semloc_core.sources import (
    GROUND_TRUTH_TOPIC,
    SCENE_GRAPH_TOPIC,
    HydraFile,
    SimulationConfig,
    Step,
    read_hydra,
    simulate_traversal,
)
from semloc_ros import conversions, qos
from semloc_ros.parameters import declare, read
from semloc_ros.running import run


class PlayerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the player; those of the walk are `SimulationConfig`'s."""

    graph: Annotated[str, Meta(description="path of the Hydra file to walk through")] = ""
    labelspace: Annotated[
        str, Meta(description="names for class ids: a shipped labelspace or a YAML file; empty: the file's own")
    ] = ""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, description="seed of everything random")] = 0
    follow_poses: Annotated[bool, Meta(description="follow the file's agent poses, where it has them")] = True
    robot: Annotated[
        str, Meta(description="of several robots' poses, whose to follow, by its node ids' letter; empty: the first")
    ] = ""
    loop: Annotated[bool, Meta(description="begin again at the end")] = False
    wait_for_subscribers: Annotated[
        int, Meta(ge=0, le=100, description="begin when so many subscribe to the updates")
    ] = 1


class Player(Node):
    """Publishes a simulated traversal: updates, and true positions on a topic of their own."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("scene_graph_player", **kwargs)
        fields = PlayerConfig.__struct_fields__ + SimulationConfig.__struct_fields__
        declare(self, PlayerConfig, fields)
        declare(self, SimulationConfig, fields, {"start_stamp_ns": 0})
        self._config: PlayerConfig = read(self, PlayerConfig)
        self._simulation: SimulationConfig = read(self, SimulationConfig)
        self._file = self._read_file()
        self._updates = self.create_publisher(String, SCENE_GRAPH_TOPIC.lstrip("/"), qos.UPDATES)
        self._truth = self.create_publisher(PointStamped, GROUND_TRUTH_TOPIC.lstrip("/"), qos.ANSWERS)
        self.create_subscription(Empty, qos.full_request_topic(self), self._on_full_request, qos.LATEST)
        self._full_asked = False
        self._seen = SceneGraph()
        self._steps: Iterator[Step] | None = None
        self._timer = self.create_timer(1.0 / self._simulation.rate_hz, self._on_timer)

    def _read_file(self) -> HydraFile:
        if not self._config.graph:
            raise FileFormatError("expected parameter 'graph' to name a Hydra file (got none)")
        file = read_hydra(self._config.graph, Reading.of(self._config.labelspace or None, None))
        for line in file.decided:
            self.get_logger().info(line)
        return file

    def _walk(self) -> Iterator[Step]:
        """The steps, stamped from now on by the node's clock unless ``start_stamp_ns`` says otherwise."""
        follow = self._config.follow_poses and self._file.agents
        agents = self._file.agents_of(self._config.robot or None) if follow else None
        for lap in itertools.count():
            config = self._simulation
            if not config.start_stamp_ns:
                config = msgspec.structs.replace(config, start_stamp_ns=self.get_clock().now().nanoseconds)
            rng = np.random.default_rng([self._config.seed, lap] if lap else self._config.seed)
            yield from simulate_traversal(self._file.graph, config, rng, agents)
            if not self._config.loop:
                return

    def _on_full_request(self, _: Empty) -> None:
        self._full_asked = True

    def _on_timer(self) -> None:
        if self._steps is None:
            if self._updates.get_subscription_count() < self._config.wait_for_subscribers:
                return
            self._steps = self._walk()
        step = next(self._steps, None)
        if step is None:
            self.get_logger().info("the walk is over")
            self._timer.cancel()
            return
        update = step.update
        self._seen.apply(update)
        if self._full_asked and not update.full:
            whole = self._seen.to_update(update.seq, update.stamp_ns, update.frame_id, update.query_place)
            update = msgspec.structs.replace(whole, odometry=update.odometry)
        self._full_asked = False
        self._updates.publish(conversions.string(update))
        self._truth.publish(conversions.point_stamped(step.position, update.stamp_ns, update.frame_id))


def main() -> int:
    """Play until the walk is over and SIGINT or SIGTERM comes."""
    return run(Player)


if __name__ == "__main__":
    sys.exit(main())
