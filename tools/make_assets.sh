#!/bin/sh
# Makes what the project ships for demo and tests, from its own generator: the same bytes on the same machine.
set -eu
python=$1
semloc() { "$python" -m semloc_core "$@"; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir -p models bags
semloc world office --seed 0 -o "$scratch/office.json"
semloc train "$scratch/office.json" --seed 0 -o models/office.model
semloc map build "$scratch/office.json" --model models/office.model --force -o models/office.map
semloc bag simulate "$scratch/office.json" --seed 1 --distance 60 --range 10 -o bags/office_run.mcap
