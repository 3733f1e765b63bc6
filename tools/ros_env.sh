# shellcheck shell=bash
# To be sourced by bash: ROS 2 Jazzy, and a network that nobody else is on.
# ROS names the installation; RMW_IMPLEMENTATION and ROS_DOMAIN_ID are kept where they are set.
ros=${ROS:-/opt/ros/jazzy}
if [ ! -e "$ros/setup.bash" ]; then
    echo "expected ROS 2 Jazzy in $ros (got nothing there); ROS=/path/to/it chooses another place" >&2
    exit 2
fi
nounset=$(set +o | grep nounset) # ROS's own scripts read what is not set
set +u
# shellcheck source=/dev/null
source "$ros/setup.bash"
eval "$nounset"
if [ -d "$ros/share/rmw_cyclonedds_cpp" ]; then
    export RMW_IMPLEMENTATION=${RMW_IMPLEMENTATION:-rmw_cyclonedds_cpp}
fi
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$(($$ % 100 + 1))}
