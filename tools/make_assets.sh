#!/bin/sh
# Makes what the project ships for demo and tests, from its own generator: the same bytes on the same machine.
set -eu
python=$1
export OMP_NUM_THREADS=1
semloc() { "$python" -m semloc_core "$@"; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir -p models bags

# What probabilities of verified answers are worth, from generated buildings alone.
"$python" -m semloc_core.evaluate.fit_confidence --force --seed 0 -o semloc_core/matching/layout/calibration.json

# An office, its model, its map, and an easy run through it.
semloc world office --seed 0 -o "$scratch/office.json"
semloc train --force "$scratch/office.json" --seed 0 -o models/office.model
semloc map build "$scratch/office.json" --model models/office.model --force -o models/office.map
semloc bag simulate --force "$scratch/office.json" --seed 1 --distance 60 --range 10 -o bags/office_run.mcap

# The demo: the office and its twin, and a run with difficulties in it.
"$python" tools/demo_run.py "$scratch"
semloc map build "$scratch/office.json" "$scratch/twin.json" --model models/office.model --force -o models/demo.map
mv "$scratch/run.mcap" bags/demo_run.mcap
