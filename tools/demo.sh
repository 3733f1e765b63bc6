#!/bin/sh
# Replays the shipped run, which is simulated, against the shipped map; results and a report go to the folder given.
set -eu
python=$1
out=$2
semloc() { "$python" -m semloc_core "$@"; }
mkdir -p "$out"
echo "A simulated run through a generated office:"
semloc replay --force bags/office_run.mcap --map models/office.map -o "$out/results.mcap" --json "$out/figures.json"
semloc report replay --force "$out/results.mcap" --map models/office.map -o "$out/report.html"
echo
echo "The same in pictures: $out/report.html"
