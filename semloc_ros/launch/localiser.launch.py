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
"""The localiser, and RViz if asked for: `ros2 launch semloc_ros localiser.launch.py map:=office.map`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "map": ("", "path of the map database"),
    "namespace": ("", "namespace of the robot"),
    "name": ("localiser", "name of the node"),
    "scene_graph": ("scene_graph", "topic of the scene-graph updates"),
    "params_file": (
        PathJoinSubstitution([FindPackageShare("semloc_ros"), "config", "localiser.yaml"]),
        "parameters of the node",
    ),
    "frame_id": ("map", "frame of the matched building; map: its name where the map holds several"),
    "publish_tf": ("false", "send the transform from frame_id to the updates' frame: semloc instead of AMCL"),
    "initialpose_after": ("0", "tell AMCL where the robot is after so many matches: semloc beside AMCL"),
    "use_sim_time": ("false", "take the time from /clock"),
    "autostart": ("true", "configure and activate without a lifecycle manager"),
    "respawn": ("true", "start the node again when it ends"),
    "rviz": ("false", "open RViz on the localiser's topics"),
    "log_level": ("info", "log level of the node"),
}


def generate_launch_description():
    """Describe what is launched."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    localiser = LifecycleNode(
        package="semloc_ros",
        executable="localiser",
        name=value["name"],
        namespace=value["namespace"],
        parameters=[
            value["params_file"],
            {
                "map": ParameterValue(value["map"], value_type=str),
                "frame_id": ParameterValue(value["frame_id"], value_type=str),
                "publish_tf": ParameterValue(value["publish_tf"], value_type=bool),
                "initialpose_after": ParameterValue(value["initialpose_after"], value_type=int),
                "use_sim_time": ParameterValue(value["use_sim_time"], value_type=bool),
                "autostart": ParameterValue(value["autostart"], value_type=bool),
            },
        ],
        remappings=[("scene_graph", value["scene_graph"])],
        arguments=["--ros-args", "--log-level", value["log_level"]],
        respawn=value["respawn"],
        respawn_delay=2.0,
        output="screen",
        emulate_tty=True,
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=value["namespace"],
        arguments=["-d", PathJoinSubstitution([FindPackageShare("semloc_ros"), "rviz", "localiser.rviz"])],
        parameters=[{"use_sim_time": ParameterValue(value["use_sim_time"], value_type=bool)}],
        condition=IfCondition(value["rviz"]),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, localiser, rviz])
