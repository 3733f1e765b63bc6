#!/bin/sh
# The environment in which the node is built and run, on a machine whose ROS 2 Jazzy comes from packages (Ubuntu
# 24.04): the system's Python packages stay in sight, PyTorch is the CPU's, and numpy is 1.26, which Jazzy's messages
# are built against.   sh tools/ros_venv.sh /usr/bin/python3 .venv [--editable]
set -eu
python=$1
venv=$2
editable=${3-}
"$python" -m venv --system-site-packages "$venv"
sh tools/install_torch.sh "$venv/bin/python"
pinned=$(mktemp)
trap 'rm -f "$pinned"' EXIT
grep -v '^numpy==' constraints.txt >"$pinned"
# shellcheck disable=SC2086  # --editable or nothing
"$venv/bin/python" -m pip --disable-pip-version-check --quiet install --constraint "$pinned" $editable '.[tools,ros]' 'numpy<2'
