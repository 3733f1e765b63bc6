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
"""`ros2 run semloc_ros detections_bridge`: 3D detections, odometry or transforms and a grid, as scene-graph updates."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Annotated, Any

from geometry_msgs.msg import TransformStamped, Vector3
from msgspec import Meta
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Empty, String
from tf2_ros import (
    Buffer,
    ConnectivityException,
    ExtrapolationException,
    InvalidArgumentException,
    LookupException,
    TransformException,
    TransformListener,
)
from vision_msgs.msg import Detection3DArray

from semloc_core.errors import MessageError, SemlocError
from semloc_core.sources import DetectionStream, LateError, NoPathError, Rigid, StreamConfig, transform_of
from semloc_core.wire import SceneGraphUpdate
from semloc_ros import conversions, qos
from semloc_ros.parameters import declare, read
from semloc_ros.running import run

POLL_S = 0.05
"""How often detections that wait for a transform are looked at."""
KEPT_S = 30.0
"""Transforms of so long are kept."""


class BridgeConfig(StreamConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the bridge; those of the graph are the core's."""

    topics: Annotated[tuple[str, ...], Meta(min_length=1, description="topics of detections, one for each camera")] = (
        "detections",
    )


class Tf2:
    """tf2's buffer as the core asks it; odometry goes in where nothing else says how the robot moves."""

    def __init__(self, node: Node) -> None:
        self._buffer = Buffer(cache_time=Duration(seconds=KEPT_S), node=node)
        self._listener = TransformListener(self._buffer, node, spin_thread=False)
        self._fed = False

    def lookup(self, target: str, source: str, stamp_ns: int) -> Rigid:
        """Give the transform from a frame into another; LateError while it may still come."""
        try:
            found = self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp_ns))
        except (LookupException, ConnectivityException, InvalidArgumentException) as error:
            raise NoPathError(target, source) from error
        except ExtrapolationException as error:
            if "past" in str(error):
                raise MessageError(f"expected an older transform of {source} (got only newer ones)") from error
            raise LateError(f"expected a newer transform of {source} (got only older ones)") from error
        except TransformException as error:
            raise MessageError(f"expected a transform of {source} (got: {error})") from error
        return transform_of(found)[3]

    def odometry(self, parent: str, child: str, stamp_ns: int, pose: Rigid) -> None:
        """Take odometry for the transform that it is, unless others send one."""
        self._fed = self._fed or not self._buffer.can_transform(parent, child, Time())
        if self._fed and parent != child:
            message = TransformStamped(header=conversions.header(stamp_ns, parent), child_frame_id=child)
            x, y, z = (float(value) for value in pose.translation)
            message.transform.translation = Vector3(x=x, y=y, z=z)
            message.transform.rotation = conversions.quaternion(pose.quaternion)
            self._buffer.set_transform(message, "odometry")


class DetectionsBridge(Node):
    """Subscribes ``detections``, ``odometry`` and ``grid``, publishes ``scene_graph``."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("detections_bridge", **kwargs)
        declare(self, BridgeConfig, BridgeConfig.__struct_fields__)
        config: BridgeConfig = read(self, BridgeConfig)
        self._tf = Tf2(self)
        self._stream = DetectionStream(config, self._tf)
        self._said: Counter[str] = Counter()
        self._publisher = self.create_publisher(String, "scene_graph", qos.UPDATES)
        for topic in config.topics:
            self.create_subscription(Detection3DArray, topic, self._guard(self._stream.detections), qos.SENSORS)
        self.create_subscription(Odometry, "odometry", self._guard(self._on_odometry), qos.SENSORS)
        for profile in (qos.LATCHED, qos.SENSORS):  # map servers' and mappers', which come late too; players'
            self.create_subscription(OccupancyGrid, "grid", self._guard(self._on_grid), profile)
        self.create_subscription(Empty, qos.full_request_topic(self), lambda _: self._stream.ask_full(), qos.LATEST)
        self.create_timer(POLL_S, self._guard(self._stream.poll))

    def _on_odometry(self, message: Odometry) -> Iterable[SceneGraphUpdate]:
        self._tf.odometry(*self._stream.odometry(message))
        return self._stream.poll()

    def _on_grid(self, message: OccupancyGrid) -> Iterable[SceneGraphUpdate]:
        self._stream.grid(message)
        return ()

    def _guard(self, take: Callable[..., Iterable[SceneGraphUpdate]]) -> Callable[..., None]:
        """Publish what a message makes; say in a line what can't be used."""

        def callback(*message: Any) -> None:
            try:
                for update in take(*message):
                    self._publisher.publish(conversions.string(update))
            except SemlocError as error:
                self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            for reason, count in (self._stream.passed_over - self._said).items():
                self.get_logger().warning(f"passed over {count} × {reason}", throttle_duration_sec=1.0)
            self._said = self._stream.passed_over.copy()

        return callback


def main() -> int:
    """Bridge until SIGINT or SIGTERM."""
    return run(DetectionsBridge)


if __name__ == "__main__":
    sys.exit(main())
