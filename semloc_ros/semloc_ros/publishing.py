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

import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.graph import SceneGraph
from semloc_core.localiser import Located
from semloc_core.map_database import LoadedMap
from semloc_ros import conversions, qos
from semloc_ros.markers import (
    MarkerIds,
    Surroundings,
    attribution_markers,
    delete_all,
    map_markers,
    match_markers,
    query_markers,
)
from semloc_ros.pose import Consistency, pose_of
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
        self._explanations = make(String, "~/explanations", qos.ANSWERS)
        self._pose = make(PoseWithCovarianceStamped, "~/pose", qos.ANSWERS)
        self._initialpose = make(PoseWithCovarianceStamped, "initialpose", qos.LATEST)
        self._markers = make(MarkerArray, "~/markers", qos.LATEST)
        self._map_markers = make(MarkerArray, "~/map_markers", qos.LATCHED)
        self._consistency = Consistency(MATCH_RADIUS_M)
        self._seeded = False
        self._ids = MarkerIds()
        self._around: dict[int, Surroundings] = {}

    def destroy(self) -> None:
        """Free the publishers."""
        for publisher in (
            self._matches,
            self._attributions,
            self._explanations,
            self._pose,
            self._initialpose,
            self._markers,
            self._map_markers,
        ):
            self._node.destroy_lifecycle_publisher(publisher)

    def answer(self, answer: Answer, config: LocaliserConfig, initialpose_after: int) -> float:
        """Publish an answer.

        Returns:
            Milliseconds from the update's arrival until its matches were handed to the middleware.

        """
        matches = answer.located.matches
        latency_ms = (time.monotonic_ns() - answer.received_ns) / 1e6
        self._matches.publish(conversions.matches_string(matches, latency_ms))
        pose = pose_of(matches)
        agreeing = self._consistency.add(matches)
        self._seeded &= agreeing > 1
        if pose is not None:
            message = conversions.pose_msg(pose, matches.stamp_ns, matches.frame_id)
            self._pose.publish(message)
            if initialpose_after and not self._seeded and agreeing >= initialpose_after:
                self._initialpose.publish(message)
                self._seeded = True
        if self._markers.get_subscription_count():
            self._markers.publish(match_markers(matches, config.top_n))
        return latency_ms

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

    def explanation(self, text: str) -> None:
        """Publish the answer to a request."""
        self._explanations.publish(String(data=text))

    def map_is_watched(self) -> bool:
        """Whether anybody has subscribed to what is drawn of the map."""
        return bool(self._map_markers.get_subscription_count())

    def map(self, loaded: LoadedMap, frame_id: str, stamp: Time, clear: bool = True) -> None:
        """Draw the map, and clear what was drawn of another one."""
        self._map_markers.publish(map_markers(loaded, frame_id, stamp))
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
