#!/usr/bin/env bash
# Builds the ROS 2 workspace with the given interpreter, whose environment holds torch, and tests it.
set -euo pipefail
python=$1
cd "$(dirname "$0")/../ros2_ws"
source ../tools/ros_env.sh
if ! "$python" -c "import rclpy" 2>/dev/null; then
    "$python" -c "import rclpy" || true
    echo "expected an interpreter that ROS 2 was built for (got $("$python" -V)): make ros PYTHON=/usr/bin/python3" >&2
    exit 2
fi
"$python" -m colcon build --event-handlers console_direct-
set +u
source install/local_setup.bash
set -u
# Plugins of pytest that ROS brings along were written for older ones; none of them is needed.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
"$python" -m colcon test --event-handlers console_direct+ --return-code-on-test-failure --pytest-args -q -p no:cacheprovider
"$python" -m colcon test-result --verbose
