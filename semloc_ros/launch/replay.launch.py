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
"""A recorded run against a map, with /clock: `ros2 launch semloc_ros replay.launch.py bag:=RUN map:=MAP`.

It ends with the bag, and with a failure where the bag can't be played, the map not be served or the answers not be
recorded. What is recorded has the bag's time.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, Shutdown
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "bag": ("", "the recorded run: an .mcap file or a rosbag2 folder"),
    "rate": ("1.0", "how many times faster than it was recorded"),
    "delay": ("5.0", "seconds until it begins: the node has loaded its map by then"),
    "record": ("", "folder to record the node's answers to; empty: do not record"),
    "map": ("", "path of the map database"),
    "namespace": ("", "namespace of the robot"),
    "frame_id": ("", "frame of the matched building; empty: the node's default"),
    "publish_tf": ("true", "join frame_id and the updates' frame, so that RViz shows both"),
    "rviz": ("false", "open RViz on the localiser's topics"),
}


def played(event, context):
    """Say what follows from the player's end."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"the bag could not be played: ros2 bag play ended with status {event.returncode}")
    return [Shutdown(reason="the bag is over")]


def recorded(event, context):
    """Say what follows from the recorder's end: it is to last until the bag is over."""
    if not context.is_shutdown:
        raise RuntimeError(f"the answers could not be recorded: ros2 bag record ended with {event.returncode}")


def generate_launch_description():
    """Describe what is launched."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    localiser = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([FindPackageShare("semloc_ros"), "launch", "localiser.launch.py"])
        ),
        launch_arguments={
            **{name: value[name] for name in ("map", "namespace", "frame_id", "publish_tf", "rviz")},
            "scene_graph": "/scene_graph",  # as in the bag, whatever the namespace
            "use_sim_time": "true",
            "exit_on_failure": "true",
            "respawn": "false",
            "required": "true",
        }.items(),
    )
    play = ["ros2", "bag", "play", value["bag"], "--clock", "--rate", value["rate"], "--delay", value["delay"]]
    record = ["ros2", "bag", "record", "--storage", "mcap", "--use-sim-time", "--output", value["record"], "--all"]
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    recording = IfCondition(NotEqualsSubstitution(value["record"], ""))
    return LaunchDescription(
        [
            *declared,
            localiser,
            ExecuteProcess(cmd=record, output="screen", condition=recording, on_exit=recorded),
            ExecuteProcess(cmd=play, output="screen", on_exit=played),
        ]
    )
