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
"""Hydra's own messages: a publisher of `hydra_msgs/DsgUpdate` → bridge → localiser → matches."""

import datetime
import math
import time

import building
import scene
import spark_dsg
from conftest import wait_for
from hydra_msgs.msg import DsgUpdate
from launch_ros.actions import Node
from scene import Watching, describe, localiser


def generate_test_description():
    """Launch a bridge that is told Hydra's topic, and a localiser."""
    bridge = Node(
        package="semloc_ros",
        executable="hydra_bridge",
        name="hydra_bridge",
        parameters=[{"full_every_s": 2.0}],
        remappings=[("dsg", "/hydra/backend/dsg")],
        output="screen",
    )
    return describe(bridge, localiser())


class TestHydra(Watching):
    """What Hydra does: it sends its whole graph, with the way that the robot went, again and again."""

    def test_the_robot_is_found_where_its_latest_pose_is(self):
        graph = spark_dsg.DynamicSceneGraph.load(str(scene.ASSETS / "home.json"))
        places = sorted(building.corridor().places.items(), key=lambda item: item[1][0])
        publisher = self.client.node.create_publisher(DsgUpdate, "/hydra/backend/dsg", 1)
        wait_for(publisher.get_subscription_count, "the bridge", 120)
        wait_for(lambda: self.client.node.count_subscribers("/scene_graph"), "the localiser", 120)
        time.sleep(2.0)  # until everyone knows everyone
        message = DsgUpdate(full_update=True)
        message.header.frame_id = "hydra_map"
        for step in range(10):
            robot = spark_dsg.AgentNodeAttributes()
            robot.position = [2.0 * step + 0.2, 0.3, 0.0]
            robot.world_R_body = spark_dsg.Quaternion(1.0, 0.0, 0.0, 0.0)
            robot.timestamp = datetime.timedelta(seconds=step)
            graph.add_node(spark_dsg.DsgLayers.AGENTS, spark_dsg.NodeSymbol("a", step).value, robot)
            message.header.stamp.sec = 100 + step
            message.layer_contents = graph.to_binary()
            publisher.publish(message)
            answer = self.client.wait_matches(step + 1)[-1]
            assert answer.stamp_ns == (100 + step) * 10**9
            assert answer.query_place == places[2 * step][0]
            if answer.status == "match":
                assert math.dist(answer.matches[0].position, places[2 * step][1]) <= 4.0
                pose = answer.matches[0].pose  # the robot's, not the place's: it stands between two
                assert math.dist(pose.position[:2], robot.position[:2]) <= 0.2
                assert abs(pose.yaw) <= 0.1
        statuses = [answer.status for answer in self.client.matches]
        assert statuses.count("match") >= 5, statuses

        # What is no graph is refused; a change of the last graph is taken.
        message.layer_contents = b"nonsense"
        publisher.publish(message)
        message.layer_contents = graph.to_binary()
        publisher.publish(message)
        self.client.wait_matches(11)
        gone = sorted(building.corridor().objects)[0]
        empty = spark_dsg.DynamicSceneGraph.from_binary(graph.to_binary())
        for node in list(empty.nodes):
            empty.remove_node(node.id.value)
        message.full_update, message.layer_contents = False, empty.to_binary()
        message.deleted_nodes = [int(gone)]
        publisher.publish(message)
        assert self.client.wait_matches(12)[-1].query_place == places[18][0]
        status = wait_for(lambda: self.client.diagnostics("localisation"), "diagnostics")
        values = {v.key: v.value for v in status.values}
        assert values["updates rejected"] == "0"
