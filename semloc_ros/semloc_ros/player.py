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
"""`ros2 run semloc_ros scene_graph_player`: walks through a Hydra file, or plays a run, as a robot would see it."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from geometry_msgs.msg import PoseStamped
from msgspec import Meta
from rclpy.node import Node
from std_msgs.msg import Empty, String

from semloc_core import wire
from semloc_core.errors import FileFormatError, GraphError, MessageError
from semloc_core.graph import Reading, SceneGraph
from semloc_core.sources import (
    GROUND_TRUTH_TOPIC,
    SCENE_GRAPH_TOPIC,
    HydraFile,
    SimulationConfig,
    StampedPose,
    Truth,
    is_run,
    read_hydra,
    read_run,
    simulate_traversal,
)
from semloc_core.wire import SceneGraphUpdate, quaternion_of
from semloc_ros import conversions, qos
from semloc_ros.parameters import declare, read
from semloc_ros.running import run


class PlayerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the player; those of the walk are `SimulationConfig`'s."""

    graph: Annotated[
        str, Meta(description="path of the Hydra file to walk through, or of a run, whose updates come at rate_hz")
    ] = ""
    building_frame: Annotated[
        str, Meta(description="frame of the ground truth: the building's, whatever the updates' is")
    ] = "map"
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


class Played(NamedTuple):
    """An update, and where the robot truly was, if that is known, in the frame that it names."""

    update: SceneGraphUpdate
    truth: Truth | None


class Player(Node):
    """Publishes a traversal, simulated or recorded: updates, and true poses on a topic of their own."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("scene_graph_player", **kwargs)
        fields = PlayerConfig.__struct_fields__ + SimulationConfig.__struct_fields__
        declare(self, PlayerConfig, fields)
        declare(self, SimulationConfig, fields, {"start_stamp_ns": 0})
        self._config: PlayerConfig = read(self, PlayerConfig)
        self._simulation: SimulationConfig = read(self, SimulationConfig)
        if not self._config.graph:
            raise FileFormatError("expected parameter 'graph' to name a Hydra file or a run (got none)")
        self._reading = Reading.of(self._config.labelspace or None, None)
        self._file = None if is_run(Path(self._config.graph)) else self._read_file()
        self._updates = self.create_publisher(String, SCENE_GRAPH_TOPIC.lstrip("/"), qos.UPDATES)
        self._truth = self.create_publisher(PoseStamped, GROUND_TRUTH_TOPIC.lstrip("/"), qos.ANSWERS)
        self.create_subscription(Empty, qos.full_request_topic(self), self._on_full_request, qos.LATEST)
        self._full_asked = False
        self._seen = SceneGraph()
        self._steps: Iterator[Played] | None = None
        self._timer = self.create_timer(1.0 / self._simulation.rate_hz, self._on_timer)

    def _read_file(self) -> HydraFile:
        file = read_hydra(self._config.graph, self._reading)
        for line in file.decided:
            self.get_logger().info(line)
        return file

    def _steps_of_laps(self) -> Iterator[Played]:
        """The steps, stamped from now on by the node's clock unless ``start_stamp_ns`` says otherwise."""
        for lap in itertools.count():
            begin_ns = self._simulation.start_stamp_ns or self.get_clock().now().nanoseconds
            yield from self._recorded(begin_ns) if self._file is None else self._walk(self._file, lap, begin_ns)
            if not self._config.loop:
                return

    def _walk(self, file: HydraFile, lap: int, begin_ns: int) -> Iterator[Played]:
        agents = file.agents_of(self._config.robot or None) if self._config.follow_poses and file.agents else None
        config = msgspec.structs.replace(self._simulation, start_stamp_ns=begin_ns)
        rng = np.random.default_rng([self._config.seed, lap] if lap else self._config.seed)
        for step in simulate_traversal(file.graph, config, rng, agents):
            turn = quaternion_of(step.heading)
            truth = StampedPose(step.update.stamp_ns, self._config.building_frame, step.position, turn)
            yield Played(step.update, truth)

    def _recorded(self, begin_ns: int) -> Iterator[Played]:
        first_ns: int | None = None
        for item in read_run(self._config.graph, robot=self._config.robot or None, reading=self._reading):
            try:
                update = wire.decode_update(item.text)
            except MessageError as error:
                self.get_logger().warning(f"an update at {item.stamp_ns} ns is left out: {error}")
                continue
            first_ns = update.stamp_ns if first_ns is None else first_ns
            update = msgspec.structs.replace(update, stamp_ns=update.stamp_ns - first_ns + begin_ns)
            yield Played(update, item.truth)

    def _on_full_request(self, _: Empty) -> None:
        self._full_asked = True

    def _on_timer(self) -> None:
        if self._steps is None:
            if self._updates.get_subscription_count() < self._config.wait_for_subscribers:
                return
            self._steps = self._steps_of_laps()
        step = next(self._steps, None)
        if step is None:
            self.get_logger().info("the walk is over")
            self._timer.cancel()
            return
        update = step.update
        try:
            self._seen.apply(update)
        except GraphError as error:
            self.get_logger().warning(f"an update of the run is left out: {error}")
            return
        if self._full_asked and not update.full:
            whole = self._seen.to_update(update.seq, update.stamp_ns, update.frame_id, update.query_place)
            update = msgspec.structs.replace(whole, odometry=update.odometry)
        self._full_asked = False
        self._updates.publish(conversions.string(update))
        if isinstance(step.truth, StampedPose):  # a position alone says no heading
            _, frame_id, position, turn = step.truth
            self._truth.publish(conversions.pose_stamped(position, turn, update.stamp_ns, frame_id))


def main() -> int:
    """Play until the walk is over and SIGINT or SIGTERM comes."""
    return run(Player)


if __name__ == "__main__":
    sys.exit(main())
