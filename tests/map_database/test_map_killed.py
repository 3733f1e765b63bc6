"""SIGKILL at any moment: the map opens with the last committed state, and with all that was reported committed."""

from __future__ import annotations

import os
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from killing import Work, calls_of, run_and_kill
from map_cases import Building, make_building, make_map, make_model

from semloc_core.encoding.model import Model
from semloc_core.map_database import LoadedMap, MapDatabase, load

ROUNDS = int(os.environ.get("SEMLOC_SOAK", "0")) or 40  # set by `make soak`
PLACES = 150

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL and fork")


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model()


def which_variant(loaded: LoadedMap, name: str, variants: list[Building]) -> int:
    """Which of the variants a building is, whole; -1 for none."""
    rows = loaded.rows_of(name)
    for i, (_, ids, positions, embeddings) in enumerate(variants):
        if (
            list(loaded.place_ids[rows]) == ids
            and np.array_equal(loaded.positions[rows], positions)
            and np.array_equal(loaded.embeddings[rows], embeddings)
        ):
            return i
    return -1


def test_killed_while_changing_buildings(tmp_path: Path, model: Model) -> None:
    """Adds, replaces and removes in a loop; each is reported after its commit."""
    path = make_map(tmp_path / "site.map", model)
    variants: list[Building] = [make_building(model, PLACES, seed) for seed in (1, 2)]
    rng = np.random.default_rng(0)
    committed: dict[str, int] = {}

    def apply(state: dict[str, int], change: str) -> None:
        verb, name, variant = change.split()
        if verb == "remove":
            del state[name]
        else:
            state[name] = int(variant)

    def changes(first: int) -> list[str]:
        steps = []
        for i in range(first, first + 200):
            steps += [f"add {i} 0", f"replace {i} 1"] + ([f"remove {i} 0"] if i % 2 else [])
        return steps

    def working(path: Path, plan: list[str]) -> Callable[[Work], None]:
        def work(given: Work) -> None:
            with MapDatabase.open(path) as database:
                given.begun()
                for change in plan:
                    verb, name, variant = change.split()
                    if verb == "remove":
                        database.remove_building(name)
                    else:
                        put = database.add_building if verb == "add" else database.replace_building
                        put(name, *variants[int(variant)])
                    given.report(change)

        return work

    usual = calls_of(working(make_map(tmp_path / "counted.map", model), changes(0)[:5])) / 5
    (tmp_path / "counted.map").unlink()

    interrupted = 0
    for n in range(ROUNDS):
        plan = changes(1000 * n)
        reported = run_and_kill(working(path, plan), round(rng.uniform(0, 6 * usual)), just_there=n % 3 > 0)
        assert reported == plan[: len(reported)]
        for change in reported:
            apply(committed, change)
        # The change under way when the signal came may have been committed before it could be reported.
        possible = dict(committed)
        for change in plan[len(reported) :][:1]:
            apply(possible, change)
        interrupted += Path(f"{path}-wal").exists()

        loaded = load(path)
        found = {name: which_variant(loaded, name, variants) for name in set(loaded.buildings) - {"a", "b"}}
        assert found in (committed, possible)
        committed = found
        with closing(sqlite3.connect(path)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert [each.name for each in tmp_path.iterdir()] == [path.name]
    assert interrupted > ROUNDS // 2, "the kills came at rest"
    assert committed, "nothing was ever committed"


def test_killed_while_creating(tmp_path: Path, model: Model) -> None:
    """Under its name there is a whole map or nothing, and the next attempt succeeds."""
    rng = np.random.default_rng(1)

    def making(path: Path) -> Callable[[Work], None]:
        def work(given: Work) -> None:
            given.begun()
            make_map(path, model)

        return work

    usual = calls_of(making(tmp_path / "first.map"))
    seen = set()
    for n in range(15):
        path = tmp_path / f"{n}.map"
        # Every fifth is killed once it is done.
        run_and_kill(making(path), round(rng.uniform(0, usual)) if n % 5 else float("inf"), just_there=n % 3 > 0)
        seen.add(path.exists())
        if path.exists():
            assert load(path).buildings in ((), ("b",), ("a", "b"))
            path.unlink()
            for suffix in ("-wal", "-shm"):
                Path(f"{path}{suffix}").unlink(missing_ok=True)
        assert load(make_map(path, model)).buildings == ("a", "b")
    assert seen == {True, False}
