#!/bin/sh
# Replays a run with difficulties in it against a map, and makes the page that plays it, in the folder given. A Hydra
# file given after it is mapped and walked in place of what is simulated.
set -eu
python=$1
out=$2
data=${3:-}
semloc() { "$python" -m semloc_core "$@"; }
mkdir -p "$out"
if [ -n "$data" ]; then
    if [ -d "$data" ]; then data=$(find "$data" -path '*goseek*' -name '*.json' | sort | head -n 1); fi
    echo "A robot's walk through $data: the building is real, the walk and what the robot sees of it are simulated."
    semloc map build --force "$data" -o "$out/demo.map"
    semloc bag simulate --force "$data" --distance 40 --range 8 -o "$out/run.mcap"
else
    echo "All simulated: a generated office, its twin with half of its furniture, and a run that starts in the dark,"
    echo "is carried elsewhere, then into the twin, and ends in a building that is not in the map."
    "$python" tools/demo_run.py "$out"
    semloc map build --force "$out/office.json" "$out/twin.json" --model models/office.model -o "$out/demo.map"
fi
semloc replay --force "$out/run.mcap" --map "$out/demo.map" -o "$out/results.mcap" --json "$out/figures.json"
semloc report replay --force "$out/results.mcap" --run "$out/run.mcap" --map "$out/demo.map" -o "$out/report.html"
echo
echo "Watch it think, in a browser: $out/report.html"
