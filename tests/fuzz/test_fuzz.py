"""A short slice of what `make fuzz` does at length, the same at every run; and inputs that were kept.

``regressions`` were once too much; ``corpus`` has one input for each line of refusal that fuzzing by coverage reached.
"""

import random
from pathlib import Path

import pytest
from fuzz_run import CORPUS, fuzz
from fuzz_targets import TARGETS

COUNTS = {"map": 150, "bag": 200, "checkpoint": 150, "localiser": 400, "localiser_filtered": 250}
KEPT = [Path(__file__).parent / "regressions", CORPUS]


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_input_is_refused_in_one_line_or_does_no_harm(name, tmp_path):
    target = TARGETS[name](tmp_path)
    found = fuzz(target, random.Random(0), count=COUNTS.get(name, 600))
    assert target.counts["refused"] > found["inputs"] // 10, found
    for path in sorted(path for folder in KEPT for path in (folder / name).glob("*")):
        target(path.read_bytes())
