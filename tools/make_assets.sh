#!/bin/sh
# Makes what the project ships for demo and tests, from its own generator: the same bytes on the same machine.
set -eu
python=$1
export OMP_NUM_THREADS=1
semloc() { "$python" -m semloc_core "$@"; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir -p models bags semloc_core/encoding/general_models

# General encoders, a labelspace each, from generated buildings alone (semloc_core/encoding/general.py).
semloc world many "$scratch/coco" --kind home --count 24 --seed 1
semloc world many "$scratch/coco" --kind coco_office --count 8 --seed 1
semloc world many "$scratch/uhumans2_office" --kind office --count 16 --seed 1
for space in coco uhumans2_office; do
    semloc train --force "$scratch/$space"/*/map.json --labelspace $space --set redecorated=1 --steps 600 --seed 0 \
        -o "semloc_core/encoding/general_models/$space.model"
done

# What probabilities of verified answers are worth, from generated buildings alone.
"$python" -m semloc_core.evaluate.fit_confidence --force --seed 0 -o semloc_core/matching/layout/calibration.json

# The demo: an office, its model, its map, and a run through it.
semloc world office --seed 0 -o "$scratch/office.json"
semloc train --force "$scratch/office.json" --seed 0 -o models/office.model
semloc map build "$scratch/office.json" --model models/office.model --force -o models/office.map
semloc bag simulate --force "$scratch/office.json" --seed 1 --distance 60 --range 10 -o bags/office_run.mcap
