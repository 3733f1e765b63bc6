"""Updates by the size of the map: each map is opened and walked through, and what each row is of is said."""

import os
from pathlib import Path

import numpy as np
import pytest

from semloc_core.benchmark.updates.by_buildings import FULL, PEER, STEPS, WHOLE, bench_update
from semloc_core.benchmark.updates.homes import Homes, generated_homes, real_homes
from semloc_core.benchmark.updates.machine import one_core, this_machine
from semloc_core.cli.commands import run
from semloc_core.metrics import update_pivots
from semloc_core.report.update_figure import update_picture
from semloc_core.sources.world import World, write_world


@pytest.fixture(scope="module")
def homes() -> Homes:
    return generated_homes(4, seed=5, distance_m=3.0, drawn=2)


def test_homes_beyond_those_drawn_are_furnished_otherwise(homes: Homes) -> None:
    assert len(homes.arrays) == len(homes.buildings) == 4
    assert len(homes.runs) == 2  # through what was drawn
    for own, other in ((0, 2), (1, 3)):
        plan, again = homes.arrays[own], homes.arrays[other]
        assert np.array_equal(plan.place_positions, again.place_positions)
        assert plan.n_objects != again.n_objects or not np.array_equal(plan.object_positions, again.object_positions)
    loaded = homes.first(3).loaded()
    assert loaded.buildings == ("home 00000", "home 00001", "home 00002")
    assert loaded.n_places == sum(home.n_places for home in homes.arrays[:3])
    assert homes.first(1).runs == homes.runs[:1]  # a robot walks only where the map is


def test_each_map_has_its_rows(homes: Homes) -> None:
    rows = bench_update(homes, (1, 4), peer_up_to=1, robots=3)
    own = [WHOLE, *(f"· {step}" for step in STEPS), FULL, "3 robots by turns, no attributions"]
    assert [row["method"] for row in rows] == [*own, PEER, *own]
    for row in rows:
        assert row["buildings"] in (1, 4)
        assert row["places"] == sum(home.n_places for home in homes.arrays[: int(row["buildings"])])
        assert 0 < row["cpu_ms"] <= row["cpu_p99_ms"]
    small, large = rows[0], rows[len(own) + 1]
    assert large["repeats"] > small["repeats"] > 5  # through two homes, and through one
    assert [row["method"] for row in rows if row.get("per_s")] == [own[-1]] * 2
    pivots = {pivot.title: pivot for pivot in update_pivots(rows)}
    assert pivots["CPU time of an update (ms), median"].columns == ["1", "4"]
    assert set(pivots["CPU time of an update (ms), median"].lines[PEER]) == {"1"}
    assert list(pivots["the map is opened in (s)"].lines) == ["map"]
    assert update_picture(rows).startswith(b"\x89PNG")


def test_real_homes_are_those_of_files(small_worlds: list[World], tmp_path: Path) -> None:
    for name, mapped in (("a", 0), ("b", 1)):
        (tmp_path / "own" / name).mkdir(parents=True)
        for role in ("map", "query"):
            write_world(tmp_path / "own" / name / f"{role}.json", small_worlds[mapped])
    (tmp_path / "other").mkdir()
    write_world(tmp_path / "other" / "c.json", small_worlds[2])
    homes = real_homes([tmp_path / "own", tmp_path / "other"], seed=0, distance_m=2.0)
    assert homes.scope == "own + other"
    assert [home.n_places for home in homes.arrays] == [len(world.graph.places) for world in small_worlds]
    assert len(homes.runs) == 2


def test_the_machine_has_a_name_and_its_cores_are_given_back() -> None:
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("threads can't be bound here")
    assert "core" in this_machine()
    before = os.sched_getaffinity(0)
    with one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before


@pytest.mark.parametrize("sizes", ["0", "one", "3,-1", ""])
def test_a_map_has_a_building_at_least(sizes: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "update", "--buildings", sizes]) == 2
    assert f"expected --buildings of at least 1, by comma (got {sizes!r})" in capsys.readouterr().err
