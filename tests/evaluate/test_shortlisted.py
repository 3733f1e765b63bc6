"""Lists of few buildings: longer ones hold the robot's more often, objects find what similarity loses."""

from pathlib import Path

import numpy as np
import pytest

from semloc_core.evaluate.shortlisted import evaluate_shortlist
from semloc_core.evaluate.town import SCOPES_M, drawn_town, read_town
from semloc_core.fleet.narrowing import ShortlistConfig
from semloc_core.metrics import shortlist_pivots
from semloc_core.sources.world import World, write_world

SCOPES = [f"{metres:g}m" for metres in SCOPES_M]


def test_a_longer_list_misses_less_and_one_of_all_nothing() -> None:
    limits = [ShortlistConfig(buildings=buildings) for buildings in (1, 3, 6)]
    rows = evaluate_shortlist(drawn_town("office", 6, seed=3), limits, walks=1, seed=3)
    assert [row["scope"] for row in rows] == SCOPES * 6
    by = {(row["method"], row["scope"]): row for row in rows}
    for scope in SCOPES:
        for ending in ("", ", by similarity alone"):
            few, more, whole = (by[f"{number} buildings{ending}", scope] for number in (1, 3, 6))
            assert few["listed"] <= more["listed"] <= whole["listed"] == 1.0
            assert few["places"] < more["places"] < whole["places"]
    assert whole["queries"] == pytest.approx(6)
    assert shortlist_pivots(rows)[0].lines["6 buildings"] == dict.fromkeys([f"{m:g} m" for m in SCOPES_M], 1.0)


def test_objects_find_homes_that_similarity_loses() -> None:
    rows = evaluate_shortlist(drawn_town("home", 24, seed=1), [ShortlistConfig(buildings=2)], walks=1)
    listed = {(row["method"], row["scope"]): row["listed"] for row in rows}
    some = [sum(listed[method, scope] for scope in SCOPES) for method in dict.fromkeys(row["method"] for row in rows)]
    assert some[0] > some[1]


def test_flats_share_their_plans() -> None:
    town = drawn_town("home", 4, plans=2, seed=2)
    sizes = [(flat.n_objects, *np.ptp(flat.place_positions[:, :2], axis=0).round(0)) for flat in town.maps]
    assert len(town.maps) == len(town.again) == 4
    assert abs(sizes[0][1] - sizes[2][1]) <= 2
    assert sizes[0] != sizes[2]


def test_real_buildings_and_those_only_in_the_map(small_worlds: list[World], tmp_path: Path) -> None:
    (tmp_path / "own" / "a").mkdir(parents=True)
    for role in ("map", "query"):
        write_world(tmp_path / "own" / "a" / f"{role}.json", small_worlds[0])
    (tmp_path / "others").mkdir()
    write_world(tmp_path / "others" / "b.json", small_worlds[1])
    town = read_town(tmp_path / "own", [tmp_path / "others"])
    assert (len(town.maps), len(town.again)) == (2, 1)
    rows = evaluate_shortlist(town, [ShortlistConfig(buildings=1)], walks=1)
    assert [row["listed"] for row in rows if row["scope"] == "40m"] == [1.0, 1.0]
