"""SIGKILL while ``semloc map merge`` runs: the map is as it was or merged, never between; so is the file of figures."""

from __future__ import annotations

import os
import random
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from killing import Work, calls_of, run_and_kill
from lived_in import office, rings, seen_again

from semloc_core import wire
from semloc_core.cli import app
from semloc_core.encoding.model import embed_graph
from semloc_core.map_database import MapDatabase, load
from semloc_core.map_merge import Merged, store
from semloc_core.sources.bag import BagWriter

ROUNDS = int(os.environ.get("SEMLOC_SOAK", "0")) or 8  # set by `make soak`
OLD = b'{"command": "", "rows": []}\n'

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL and fork")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A map of an office, and the words of the command that merges a later traversal into it."""
    folder = tmp_path_factory.mktemp("merged")
    arrays, space = office()
    model = rings(space)
    with MapDatabase.create(folder / "before.map", model) as database:
        graph = arrays.to_scene_graph(space)
        database.add_building("office", graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))
    with BagWriter(folder / "later.mcap") as bag:
        later = seen_again(arrays, space).to_update(seq=0, stamp_ns=0, frame_id="odom")
        bag.write_string("/scene_graph", 0, wire.encode(later))
    return folder, ["map", "merge", str(folder / "office.map"), str(folder / "later.mcap")]


def test_killed_while_merging(case: tuple[Path, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, words = case
    path, figures = folder / "office.map", folder / "figures.json"
    words = [*words, "--json", str(figures), "--force"]
    shutil.copy(folder / "before.map", path)
    propose, writing = store.propose, store.write
    proposed: list[tuple[str, Merged]] = []

    def kept(*given: Any, **options: Any) -> tuple[str, Merged]:
        if not proposed:  # the same each time, and nothing is written yet
            proposed.append(propose(*given, **options))
        return proposed[0]

    monkeypatch.setattr(store, "propose", kept)
    before = load(path).hash
    app(words, standalone_mode=False)  # loads modules
    merged, whole = load(path).hash, figures.read_bytes()
    assert before != merged

    def work(given: Work) -> None:
        def counted(*args: Any) -> None:
            given.begun()
            writing(*args)

        monkeypatch.setattr(store, "write", counted)  # in the child alone
        app(words, standalone_mode=False)

    shutil.copy(folder / "before.map", path)
    usual = calls_of(work)  # from where the map is about to be changed to the command's end
    rng, found = random.Random(0), []
    for n in range(ROUNDS):
        shutil.copy(folder / "before.map", path)
        figures.write_bytes(OLD)
        # The first at once, the last when all is done.
        at = {0: 0.0, ROUNDS - 1: float("inf")}.get(n, rng.randint(1, usual))
        run_and_kill(work, at, just_there=n % 3 < 2)
        state = load(path).hash
        assert state in (before, merged)
        with closing(sqlite3.connect(path)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        said = figures.read_bytes()
        assert said == OLD or (said == whole and state == merged)
        found.append(state == merged)
        shown = {each.name for each in folder.iterdir() if not each.name.startswith(".")}
        assert shown == {"before.map", "later.mcap", path.name, figures.name}
    assert set(found) == {False, True}, "all kills came too early, or too late"
