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
"""What the node publishes of answers and explanations."""

from __future__ import annotations

import threading
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.matching import Located
from semloc_core.wire import matched_pose, moved
from semloc_ros import conversions, qos
from semloc_ros.markers import (
    Laid,
    MarkerIds,
    Surroundings,
    attribution_markers,
    class_colour,
    delete_all,
    laid_markers,
    map_markers,
    match_markers,
    no_robot,
    query_markers,
    robot_markers,
)
from semloc_ros.parameters import NodeConfig
from semloc_ros.pose import Seeding
from semloc_ros.tf import Stamped, Steady
from semloc_ros.worker import Answer


class Publishing:
    """The node's publishers, silent while it is inactive. Answers come from one thread, attributions from another.

    Args:
        node: owns them.

    """

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        make = node.create_lifecycle_publisher
        self._matches = make(String, "~/matches", qos.ANSWERS)
        self._attributions = make(String, "~/attributions", qos.ANSWERS)
        self._evidence = make(String, "~/evidence", qos.ANSWERS)
        self._explanations = make(String, "~/explanations", qos.ANSWERS)
        self._pose = make(PoseWithCovarianceStamped, "~/pose", qos.ANSWERS)
        self._tf = make(TFMessage, "/tf", qos.TRANSFORMS)
        self._initialpose = make(PoseWithCovarianceStamped, "initialpose", qos.LATEST)
        self._markers = make(MarkerArray, "~/markers", qos.LATEST)
        self._map_markers = make(MarkerArray, "~/map_markers", qos.LATCHED)
        self._transform = Steady(lambda line: node.get_logger().error(line))
        self._amcl = node.create_subscription(
            PoseWithCovarianceStamped, "amcl_pose", lambda _: self._seeding.answered(), qos.LATEST
        )
        self._seeding = Seeding(MATCH_RADIUS_M)
        self._seed_lock = threading.Lock()
        self._told: PoseWithCovarianceStamped | None = None
        self._seed: PoseWithCovarianceStamped | None = None
        self._ids = MarkerIds()
        self._drawn: tuple[str, str, dict[str, wire.Position]] | None = None
        self._around: dict[int, Surroundings] = {}

    def destroy(self) -> None:
        """Free the publishers."""
        for publisher in (
            self._matches,
            self._attributions,
            self._evidence,
            self._explanations,
            self._pose,
            self._tf,
            self._initialpose,
            self._markers,
            self._map_markers,
        ):
            self._node.destroy_lifecycle_publisher(publisher)
        self._node.destroy_subscription(self._amcl)

    def answer(self, answer: Answer, localiser: Localiser, config: NodeConfig) -> float:
        """Publish an answer.

        Returns:
            Milliseconds from the update's arrival until its matches were handed to the middleware.

        """
        matches = answer.located.matches
        latency_ms = (time.monotonic_ns() - answer.received_ns) / 1e6
        self._matches.publish(conversions.matches_string(matches, latency_ms))
        if config.publish_tf:
            child, tolerance_s = answer.update.frame_id, config.transform_tolerance
            self._send(self._transform.answer(matches, child, *self._clocks(), tolerance_s))
        pose = matched_pose(matches)
        told = self._seeding.add(matches)
        message = None
        if pose is not None:
            message = conversions.pose_msg(pose, answer.update.odometry, matches.stamp_ns, matches.frame_id)
            self._pose.publish(message)
        self._seed = message if told else None
        self._tell(config)
        if self._markers.get_subscription_count():
            self._markers.publish(match_markers(matches, localiser.config.top_n, localiser.frame_of))
            self._draw_robot(matches, message)
        return latency_ms

    def again(self, config: NodeConfig) -> None:
        """Say again what is due: the transform, the pose to AMCL; to be called each `semloc_ros.tf.PERIOD_S`."""
        self._tell(config)
        if config.publish_tf:
            self._send(self._transform.tick(*self._clocks(), config.transform_tolerance))

    def forget(self) -> None:
        """Send no transform and no initial pose until the next match."""
        self._transform.forget()
        self._seed = None

    def _draw_robot(self, matches: wire.PlaceMatches, pose: PoseWithCovarianceStamped | None) -> None:
        if pose is None:
            self._markers.publish(no_robot(conversions.header(matches.stamp_ns, matches.frame_id)))
            return
        known = matches.matches[0].pose
        self._markers.publish(robot_markers(pose, known is not None and known.yaw is not None))

    def _laid(self, evidence: wire.ClassAttributions, located: Located, graph: SceneGraph) -> list[Laid]:
        transform, building, loaded = located.matches.transform, evidence.match_map, located.map
        if transform is None or building is None:
            return []
        if self._drawn is None or self._drawn[:2] != (loaded.hash, building):  # reading a building takes a while
            there = {node: item.position for node, item in loaded.graph(building).objects.items()}
            self._drawn = loaded.hash, building, there
        mapped, space = self._drawn[2], loaded.model.labelspace
        return [
            Laid(
                moved(transform, graph.objects[item.id].position),
                class_colour(space.index(graph.objects[item.id].class_), len(space)),
                mapped.get(item.mapped) if item.mapped is not None else None,
            )
            for item in evidence.objects
            if item.id in graph.objects
        ]

    def _tell(self, config: NodeConfig) -> None:
        seed, topic = self._seed, self._initialpose
        if seed is None or not config.initialpose_after:
            return
        amcl, listeners = self._node.count_publishers("amcl_pose") > 0, topic.get_subscription_count()
        with self._seed_lock:
            due = self._seeding.due(config.initialpose_after, listeners, amcl, time.monotonic())
        if due:
            self._told = seed
            topic.publish(seed)

    def told(self, message: PoseWithCovarianceStamped) -> bool:
        """Whether an initial pose is this node's own."""
        return message == self._told

    def _clocks(self) -> tuple[int, int]:
        return self._node.get_clock().now().nanoseconds, time.monotonic_ns()

    def _send(self, stamped: Stamped | None) -> None:
        if stamped is not None:
            self._tf.publish(conversions.tf_msg(stamped))

    def query(self, answer: Answer, graph: SceneGraph | None) -> None:
        """Draw the query, and keep what is around it for the explanation of this answer.

        Args:
            answer: the answer.
            graph: the graph as it was for this answer.

        """
        if not self._markers.get_subscription_count():
            return
        around = surroundings(answer, graph)
        self._markers.publish(query_markers(answer.located.matches, around))
        if around is not None and answer.explain:
            self._around[answer.located.query.seq] = around
            if len(self._around) > 100:
                del self._around[next(iter(self._around))]

    def attributions(self, located: Located, message: wire.ClassAttributions, text: str) -> None:
        """Publish why an answer was given."""
        self._attributions.publish(String(data=text))
        around = self._around.pop(located.query.seq, None)
        if around is not None:
            scores = {item.id: item.score for item in message.objects}
            self._markers.publish(attribution_markers(scores, around, self._ids, message.stamp_ns))

    def evidence(self, message: wire.ClassAttributions, answer: Answer, graph: SceneGraph | None) -> None:
        """Publish what a decision rests on, and draw it: seen objects on the map, joined to what explains them.

        Args:
            message: the evidence.
            answer: what it is the evidence of.
            graph: the graph as it was for this answer.

        """
        self._evidence.publish(conversions.string(message))
        if graph is not None and self._markers.get_subscription_count():
            objects = self._laid(message, answer.located, graph)
            self._markers.publish(laid_markers(conversions.header(message.stamp_ns, message.frame_id), objects))

    def explanation(self, text: str) -> None:
        """Publish the answer to a request."""
        self._explanations.publish(String(data=text))

    def map_is_watched(self) -> bool:
        """Whether anybody has subscribed to what is drawn of the map."""
        return bool(self._map_markers.get_subscription_count())

    def map(self, localiser: Localiser, stamp: Time, clear: bool = True) -> None:
        """Draw the map, and clear what was drawn of another one."""
        self._map_markers.publish(map_markers(localiser.map, localiser.frame_of, stamp))
        if clear:
            self._markers.publish(delete_all())


def surroundings(answer: Answer, graph: SceneGraph | None) -> Surroundings | None:
    """Positions of the query place and of the objects around it; None where there is no query place."""
    query = answer.located.query
    if graph is None or query.place not in graph.places:
        return None
    ids = query.batch.node_ids if query.batch is not None else ()
    positions = {node: graph.objects[node].position for node in ids if node in graph.objects}
    return Surroundings(answer.update.frame_id, graph.places[query.place], positions)
