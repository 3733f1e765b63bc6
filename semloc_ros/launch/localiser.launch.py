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
"""The localiser, and RViz if asked for: `ros2 launch semloc_ros localiser.launch.py map:=office.map`.

An argument that is given wins over what params_file says, and that over the node's own defaults.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, TimerAction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

OVERRIDES = {
    "map": (str, "path of the map database"),
    "frame_id": (str, "frame of the matched building; map: its name where the map holds several"),
    "publish_tf": (bool, "send the transform from frame_id to the updates' frame: semloc instead of AMCL"),
    "initialpose_after": (int, "tell AMCL where the robot is after so many matches: semloc beside AMCL"),
    "use_sim_time": (bool, "take the time from /clock"),
    "autostart": (bool, "configure and activate without a lifecycle manager"),
    "exit_on_failure": (bool, "end where autostart fails, instead of trying again"),
}
ARGUMENTS = {
    **{name: ("", f"{text}; not given: what params_file says") for name, (_, text) in OVERRIDES.items()},
    "namespace": ("", "namespace of the robot"),
    "name": ("localiser", "name of the node"),
    "scene_graph": ("scene_graph", "topic of the scene-graph updates"),
    "params_file": (
        PathJoinSubstitution([FindPackageShare("semloc_ros"), "config", "localiser.yaml"]),
        "parameters of the node",
    ),
    "respawn": ("true", "start the node again when it ends, but for parameters that are not allowed"),
    "required": ("false", "end the launch, and with a failure, when the node ends in one"),
    "rviz": ("false", "open RViz on the localiser's topics"),
    "log_level": ("info", "log level of the node"),
}
RESPAWN_DELAY_S = 2.0
NOT_ALLOWED = 2
"""The node's exit status where its parameters are not allowed: they still would not be the next time."""


def parameters_of(context):
    """What the node and RViz are given: the file, then the arguments that were given."""
    given = [name for name in OVERRIDES if context.launch_configurations[name]]
    return [
        LaunchConfiguration("params_file"),
        {name: ParameterValue(LaunchConfiguration(name), value_type=OVERRIDES[name][0]) for name in given},
    ]


def is_true(context, name):
    """Whether an argument is true."""
    return context.launch_configurations[name].lower() in ("true", "1")


def ended(event, context):
    """Say what follows from the node's end."""
    if context.is_shutdown:
        return None
    if is_true(context, "required") and event.returncode != 0:
        raise RuntimeError(f"the localiser ended with status {event.returncode}")
    if not is_true(context, "respawn"):
        return None
    if event.returncode == NOT_ALLOWED:
        return [LogInfo(msg="the localiser is not started again: its parameters are not allowed")]
    return [TimerAction(period=RESPAWN_DELAY_S, actions=localiser(context))]


def localiser(context):
    """Describe the node; launch's own respawn would not ask why it ended."""
    return [
        LifecycleNode(
            package="semloc_ros",
            executable="localiser",
            name=LaunchConfiguration("name"),
            namespace=LaunchConfiguration("namespace"),
            parameters=parameters_of(context),
            remappings=[("scene_graph", LaunchConfiguration("scene_graph"))],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            on_exit=ended,
            output="screen",
            emulate_tty=True,
        )
    ]


def rviz(context):
    """Describe RViz."""
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            namespace=LaunchConfiguration("namespace"),
            arguments=["-d", PathJoinSubstitution([FindPackageShare("semloc_ros"), "rviz", "localiser.rviz"])],
            parameters=parameters_of(context),
        )
    ]


def generate_launch_description():
    """Describe what is launched."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription(
        [
            *declared,
            OpaqueFunction(function=localiser),
            OpaqueFunction(function=rviz, condition=IfCondition(LaunchConfiguration("rviz"))),
        ]
    )
