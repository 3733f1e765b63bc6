"""Answers along walks in a town are those of the localiser that opens it."""

from pathlib import Path

import pytest

from semloc_core.evaluate.town import SCOPES_M, drawn_town, evaluate_town, read_town
from semloc_core.sources.world import World, write_world


def test_homes_are_told_apart_and_twins_are_not_believed() -> None:
    homes = evaluate_town(drawn_town("home", 5, seed=4), walks=2)
    flats = evaluate_town(drawn_town("home", 5, plans=1, lacks=0.0, seed=4), walks=2)
    for rows in (homes, flats):
        assert [row["scope"] for row in rows] == [f"{metres:g}m" for metres in SCOPES_M]
        for row in rows:
            assert row["match"] + row["ambiguous"] + row["unknown"] == pytest.approx(1)
            assert row["wrong_building"] <= row["wrong_match"] <= row["match"]
            assert (row["rivals_right"] is None) == (row["ambiguous"] == 0)
            assert row["listed"] == 1.0  # so few are all looked at
            assert row["queries"] == 10
    assert homes[-1]["success@1"] >= 0.8
    # Five flats that are alike in all: which of them it is can't be known.
    assert flats[-1]["success@1"] < 0.7
    assert flats[-1]["ambiguous"] > homes[-1]["ambiguous"]
    assert flats[-1]["wrong_match"] <= 0.1


def test_each_building_by_itself(small_worlds: list[World], tmp_path: Path) -> None:
    for name, world in zip("ab", small_worlds, strict=False):
        (tmp_path / name).mkdir()
        for role in ("map", "query"):
            write_world(tmp_path / name / f"{role}.json", world)
    rows = evaluate_town(read_town(tmp_path), walks=2, alone=True)
    assert rows[-1]["success@1"] == 1.0
    assert all(row["wrong_building"] == 0.0 for row in rows)
