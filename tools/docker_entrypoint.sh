#!/bin/bash
# Runs a command where ROS 2 and the workspace are known.
set -e
source /opt/ros/jazzy/setup.bash
source /opt/semloc/ros2_ws/install/local_setup.bash
exec "$@"
