#!/usr/bin/env bash
# Runs the node as a user would and writes down what was typed and what was answered: docs/ros_transcript.md.
# Works on what the project ships (models/office.map, bags/office_run.mcap; made anew under out/ros where they are
# missing) and, where SEMLOC_DATA names the real scene graphs, on these too. Build the workspace first: make ros.
#   bash tools/ros_transcript.sh [PYTHON] [OUTPUT]
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
output=${2:-docs/ros_transcript.md}
source tools/ros_env.sh
set +u
source ros2_ws/install/local_setup.bash
set -u
data=${SEMLOC_DATA:-../shared/data}
scratch=out/ros
mkdir -p "$scratch" "$(dirname "$output")"
semloc() { "$python" -m semloc_core "$@" 2>/dev/null; }
pids=()
finish() { for pid in "${pids[@]}"; do kill -INT -- "-$pid" 2>/dev/null || true; done; ros2 daemon stop >/dev/null 2>&1 || true; }
trap finish EXIT
ros2 daemon start >/dev/null

say() { printf '%s\n' "$@" >>"$output"; }

# A command as one would type it.
typed() { for word in "$@"; do case $word in *' '*) printf ' "%s"' "${word//\"/\\\"}" ;; *) printf ' %s' "$word" ;; esac; done; }

# Types a command and writes down its answer, long lines cut as a terminal would.
show() {
    say '```console' "\$$(typed "$@")"
    timeout 120 "$@" 2>&1 | sed -E 's/\x1b\[[0-9;]*m//g' | cut -c1-"${WIDTH:-400}" | head -n "${LINES_SHOWN:-40}" >>"$output" || true
    say '```' ''
}

# Starts a command in a process group of its own and leaves it running.
start() {
    say '```console' "\$$(typed "$@") &" '```' ''
    set -m
    "$@" >"$scratch/$1-${#pids[@]}.log" 2>&1 &
    set +m
    pids+=($!)
}

# Sends Ctrl-C, and writes down what status came of it.
stop() {
    local status=0
    kill -INT -- "-$1"
    wait "$1" || status=$?
    say "It ended with status $status." ''
}

# Waits until the localiser is there, or a message has come on a topic.
wait_node() { for _ in $(seq 120); do ros2 lifecycle get /localiser 2>/dev/null | grep -q '\[' && return; sleep 0.5; done; }
wait_topic() { timeout 60 ros2 topic echo --once "$1" >/dev/null 2>&1 || true; }

map=models/office.map
run=bags/office_run.mcap
if [ ! -e "$map" ] || [ ! -e "$run" ]; then
    map=$scratch/office.map
    run=$scratch/office_run.mcap
    semloc world office -o "$scratch/office.json" >/dev/null
    semloc train "$scratch/office.json" --encoder rings -o "$scratch/office.model" >/dev/null
    semloc map build "$scratch/office.json" --model "$scratch/office.model" --force -o "$map" >/dev/null
    semloc bag simulate --force "$scratch/office.json" --distance 60 --seed 1 -o "$run" >/dev/null
fi
cp "$map" "$scratch/other.map"

: >"$output"
say '# The node at work' '' \
    "What follows was typed by \`tools/ros_transcript.sh\`, which anyone with ROS 2 Jazzy can run; long lines are cut." '' \
    '## Lifecycle and parameters' ''
start ros2 run semloc_ros localiser --ros-args -p "map:=$map" -p autostart:=false
wait_node
show ros2 lifecycle get /localiser
show ros2 lifecycle set /localiser configure
show ros2 lifecycle set /localiser activate
show ros2 param describe /localiser explain_rate_hz accept_probability explainer
show ros2 param set /localiser top_n 0
show ros2 topic list -t

say '## A simulated run, played from a bag' ''
start ros2 bag play "$run" --loop
wait_topic /localiser/attributions
WIDTH=700 show ros2 topic echo --once --full-length --field data /localiser/matches
WIDTH=1200 show ros2 topic echo --once --full-length --field data /localiser/attributions
show ros2 topic echo --once --field pose.pose /localiser/pose
LINES_SHOWN=50 show ros2 topic echo --once /localiser/matches_typed
LINES_SHOWN=4 show timeout 8 ros2 topic hz /localiser/matches

say '## Another map while it runs, and one that is not there' ''
show ros2 param set /localiser map "$scratch/nowhere.map"
show ros2 param set /localiser map "$scratch/other.map"
show ros2 service call /localiser/reload_map std_srvs/srv/Trigger

say '## Why?' ''
WIDTH=1600 show ros2 service call /localiser/explain std_srvs/srv/Trigger

say 'Any pair of query and place, by topic:' ''
start ros2 topic echo --once --full-length --field data /localiser/explanations
for _ in $(seq 60); do ros2 topic info /localiser/explanations | grep -q 'Subscription count: 1' && break; sleep 0.5; done
request='{"schema":"semloc/explain_request/1","stamp_ns":0,"frame_id":"","seq":7,"methods":["class_shapley"]}'
show ros2 topic pub --once -w 1 /localiser/explain_request std_msgs/msg/String "data: '$request'"
wait "${pids[-1]}" || true
say '```console' "$(cut -c1-900 "$scratch/ros2-$((${#pids[@]} - 1)).log")" '```' ''

say '## How is it doing?' ''
sleep 15 # "lost or changed?" compares the latest 60 answers with the map
LINES_SHOWN=120 show ros2 topic echo --once /diagnostics

say '## The end' ''
show ros2 lifecycle set /localiser deactivate
show ros2 lifecycle set /localiser cleanup
say 'Ctrl-C:' ''
kill -INT -- "-${pids[1]}" 2>/dev/null || true
stop "${pids[0]}"

say '## Where the robot is, as tf2 has it' '' \
    'A robot whose odometry drifts by the usual walks through the office; its updates are in the frame odom:' ''
rm -f "$scratch/office_walked.json"
semloc world office -o "$scratch/office_walked.json" >/dev/null
pids=()
start ros2 launch semloc_ros localiser.launch.py "map:=$map" publish_tf:=true
wait_node
show ros2 param set /localiser accept_probability 0.9
start ros2 run semloc_ros scene_graph_player --ros-args -p "graph:=$scratch/office_walked.json" -p frame_id:=odom -p shared_frame:=true -p drift:=1.0
wait_topic /localiser/pose
LINES_SHOWN=16 show timeout 6 ros2 run tf2_ros tf2_echo map odom
show ros2 topic echo --once --field pose.pose /localiser/pose
say 'and where it truly is, a moment later:' ''
show ros2 topic echo --once /ground_truth
WIDTH=700 show ros2 topic echo --once --full-length --field data /localiser/evidence
LINES_SHOWN=4 show timeout 8 ros2 topic hz /tf
kill -INT -- "-${pids[1]}" "-${pids[0]}" 2>/dev/null || true
sleep 2

if [ -d "$data/hydra" ]; then
    say '## On a real scene graph' '' \
        "A map of Hydra's long run through the uHumans2 apartment (\`hydra/apartment_long.json\` in the folder of real" \
        'graphs), and the short run played as a traversal along its recorded poses:' ''
    semloc train --force "$data/hydra/apartment_long.json" --encoder rings --labelspace uhumans2_apartment -o "$scratch/apartment.model" >/dev/null
    semloc map build "$data/hydra/apartment_long.json" --model "$scratch/apartment.model" --name apartment --force -o "$scratch/apartment.map" >/dev/null
    cp "$data/hydra/apartment_short.json" "$scratch/apartment_short.json"
    pids=()
    start ros2 launch semloc_ros localiser.launch.py "map:=$scratch/apartment.map" frame_id:=apartment
    wait_node
    start ros2 run semloc_ros scene_graph_player --ros-args -p "graph:=$scratch/apartment_short.json" -p labelspace:=uhumans2_apartment -p loop:=true -p miss_rate:=0.0 -p false_rate:=0.0
    wait_topic /localiser/attributions
    sleep 5
    WIDTH=700 show ros2 topic echo --once --full-length --field data /localiser/matches
    WIDTH=1200 show ros2 topic echo --once --full-length --field data /localiser/attributions
    kill -INT -- "-${pids[1]}" "-${pids[0]}" 2>/dev/null || true
    rm -f "$scratch/apartment_short.json"
fi
