"""Lists of few buildings: longer ones hold the robot's more often, and one of all always does."""

import pytest

from semloc_core.evaluate.shortlisted import SCOPES_M, evaluate_shortlist
from semloc_core.fleet.narrowing import ShortlistConfig


def test_a_longer_list_misses_less_and_one_of_all_nothing():
    limits = [ShortlistConfig(nearest=n, buildings=b) for n, b in ((1, 1), (50, 2), (10_000, 6))]
    rows = evaluate_shortlist("office", 6, limits, walks=1, seed=3)
    assert [row["scope"] for row in rows] == [f"{metres:g}m" for metres in SCOPES_M] * 3
    short, some, everything = (rows[i : i + len(SCOPES_M)] for i in range(0, len(rows), len(SCOPES_M)))
    for few, more, whole in zip(short, some, everything, strict=True):
        assert few["listed"] <= more["listed"] <= whole["listed"] == 1.0
        assert few["places"] <= more["places"] <= whole["places"]
    assert min(row["listed"] for row in short) < 1.0
    assert short[0]["places"] < some[0]["places"] < everything[0]["places"]
    assert whole["queries"] == pytest.approx(6)
