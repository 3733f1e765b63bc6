"""Many writers at once, and one killed at any moment: a map is always as it was before a change or as after it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fleet_writers import add, building_named, churn, preload, replace, start, variants, which
from map_cases import make_building, make_model

from semloc_core.errors import MapError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.map_database import MapDatabase, load
from semloc_core.map_database.history import ClassChange, History, Traversal

ROUNDS = int(os.environ.get("SEMLOC_SOAK", "0")) or 15  # set by `make soak`

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL and fork")


@pytest.fixture
def empty(address: MilvusAddress) -> MilvusAddress:
    preload()
    FleetDatabase.create(address, make_model()).close()
    return address


def rows(address: MilvusAddress) -> dict[str, set[int]]:
    """Generations that have rows, by collection."""
    server = Server(address)
    name = address.name
    found = {
        kind: {row["generation"] for row in server.query_all(collection, "generation > 0", ("generation",), 10**6)}
        for kind, collection in (
            ("places", layout.places(name, 6)),
            ("blobs", layout.blobs(name)),
            ("generations", layout.generations(name)),
        )
    }
    server.close()
    return found


def test_writers_add_buildings_at_once(empty: MilvusAddress, tmp_path: Path) -> None:
    """What they leave is the file with the same buildings, in whatever order they came."""
    names = [f"site '{site}\"/{i} Ö\\" for site in "xyz" for i in range(4)]
    writers = [start(add, empty, names[i::3]) for i in range(3)]
    for process, said in writers:
        assert said.recv() == "done"
        process.join()
    model = make_model()
    with MapDatabase.create(tmp_path / "same.map", model) as database:
        for name in reversed(names):
            database.add_building(name, *building_named(model, name))
    source = MilvusSource(empty)
    assert list(source.catalogue().buildings) == sorted(names)
    assert source.catalogue().content_hash == load(tmp_path / "same.map").hash
    source.close()


def test_two_replace_one_building_while_a_robot_reads(empty: MilvusAddress) -> None:
    """Whatever is read is one of the two, whole: graph, places and what the search finds."""
    model = make_model()
    both = variants(model)
    with FleetDatabase.open(empty) as database:
        database.add_building("home", *both[0])
        database.add_building("other", *make_building(model, 6, 9))
    source = MilvusSource(empty, poll_s=0.0)
    writers = [start(replace, empty, "home", first, 15) for first in (0, 1)]
    seen = []
    while any(process.is_alive() for process, _ in writers):
        fetched = source.fetch("home")
        seen.append(which(fetched, both))
        assert len(fetched.stored.graph.data) > 0
        nearest = source.nearest(both[0][3][0], 60)
        # A search sees one generation of each building, so no more places than that has.
        assert nearest.buildings.count("home") in (20, 31), nearest.buildings
        assert nearest.buildings.count("other") == 6
        assert len(set(zip(nearest.buildings, nearest.place_ids, strict=True))) == len(nearest.place_ids)
    assert set(seen) == {0, 1}, "the reader saw but one state"
    source.close()


def test_killed_while_changing_buildings(empty: MilvusAddress) -> None:
    """The map is as after the last change that was reported, or as after the next one; sweeping leaves no rest."""
    model = make_model()
    both = variants(model)
    rng = np.random.default_rng(0)
    plan = [f"{verb} counted{i} 0" for verb in ("add", "remove") for i in range(4)]
    child, said = start(churn, empty, plan, float("inf"))
    reported = [said.recv() for _ in range(len(plan) + 1)]
    child.join()
    assert reported[:-1] == plan
    usual = int(reported[-1].removeprefix("calls ")) / len(plan)
    committed: dict[str, int] = {}
    source = MilvusSource(empty, poll_s=0.0)
    left_over = 0
    checked: dict[str, int] = {}
    for n in range(ROUNDS):
        plan = [
            f"{verb} {n}_{i} {v}"
            for i in range(60)
            for verb, v in (("add", 0), ("replace", 1), ("remove", 0))[: 2 + i % 2]
        ]
        child, said = start(churn, empty, plan, round(rng.uniform(0, 8 * usual)))
        child.join()
        assert child.exitcode == -signal.SIGKILL
        reported = []
        while said.poll():
            try:
                reported.append(said.recv())
            except (EOFError, OSError):
                break
        assert reported == plan[: len(reported)]
        for change in reported:
            apply(committed, change)
        possible = dict(committed)
        apply(possible, plan[len(reported)])
        for name, entry in source.catalogue().buildings.items():
            if entry.generation not in checked:  # what is in a generation never changes
                checked[entry.generation] = which(source.fetch(name), both)
        found = {name: checked[entry.generation] for name, entry in source.catalogue().buildings.items()}
        assert found in (committed, possible)
        committed = found
        there = rows(empty)
        left_over += bool((there["places"] | there["blobs"]) - live(source))
        # What has rows is known by a row of its own, so a sweep finds it.
        assert there["places"] | there["blobs"] <= there["generations"]
    assert committed, "nothing was ever committed"
    assert left_over, "no kill came between the first row and the last"
    with FleetDatabase.open(empty) as database:
        assert database.sweep(0) > 0
        assert database.sweep(0) == 0
    there = rows(empty)
    assert there["places"] == live(source)
    assert there["generations"] == there["blobs"]
    assert len(there["blobs"] - there["places"]) == 1  # the model
    assert {name: which(source.fetch(name), both) for name in source.catalogue().buildings} == committed
    source.close()


def apply(state: dict[str, int], change: str) -> None:
    verb, name, variant = change.split()
    if verb == "remove":
        del state[name]
    else:
        state[name] = int(variant)


def live(source: MilvusSource) -> set[int]:
    return {int(entry.generation) for entry in source.catalogue().buildings.values()}


def test_what_builds_on_what_was_read_is_refused_when_that_has_changed(empty: MilvusAddress) -> None:
    """A merge must not undo what another writer did meanwhile."""
    model = make_model()
    both = variants(model)
    with FleetDatabase.open(empty) as one, FleetDatabase.open(empty) as two:
        one.add_building("home", *both[0])
        graph, ids, positions, embeddings = both[0]

        def both_at_once(ours: Callable[[], None], theirs: Callable[[], None]) -> None:
            with one.transaction():
                ours()
                theirs()

        with pytest.raises(MapError, match="'home', which another writer changed meanwhile"):
            both_at_once(
                lambda: one.revise_building("home", graph, positions, -embeddings),
                lambda: two.replace_building("home", *both[1]),
            )
        source = MilvusSource(empty, poll_s=0.0)
        assert which(source.fetch("home"), both) == 1
        with pytest.raises(MapError, match="'home', which another writer changed meanwhile"):
            both_at_once(
                lambda: one.replace_places("home", ids[:3], positions[:3], embeddings[:3]),
                lambda: two.remove_building("home"),
            )
        # Whoever replaces a building or adds one does not build on what was there.
        with pytest.raises(MapError, match="the map does not have"):
            both_at_once(lambda: one.add_building("home", *both[0]), lambda: two.add_building("home", *both[1]))
        both_at_once(lambda: one.replace_building("home", *both[0]), lambda: two.remove_building("home"))
        assert which(source.fetch("home"), both) == 0
        source.close()


def test_all_buildings_are_embedded_with_the_same_weights_of_classes(empty: MilvusAddress) -> None:
    """A merge changes what a class weighs in all buildings, those that another writer adds meanwhile included."""
    model = make_model()
    taught = History(
        traversals=(Traversal("x", 0.0, (0.0, 0.0, 0.0), 0.0, 1, 1, 0, 0, 0, 0),),
        classes={"chair": ClassChange(1.0, 5.0)},
    )
    graph, _, positions, embeddings = variants(model)[0]
    with FleetDatabase.open(empty) as one, FleetDatabase.open(empty) as two:
        one.add_building("home", *variants(model)[0])
        one.add_building("other", *variants(model)[1])

        def add_while_another_merges() -> None:
            with one.transaction():
                one.add_building("late", *make_building(model, 5))
                two.revise_building("home", graph, positions, embeddings, taught)

        with pytest.raises(MapError, match="another writer merged meanwhile: try again"):
            add_while_another_merges()
        one.add_building("late", *make_building(model, 5))

        def merge_while_another_adds() -> None:
            with one.transaction():
                one.revise_building("home", graph, positions, embeddings, History())
                two.add_building("later", *make_building(model, 5))

        with pytest.raises(MapError, match="'later', which another writer added meanwhile"):
            merge_while_another_adds()
        # What no weight depends on goes on side by side.
        with one.transaction():
            one.replace_building("other", *variants(model)[0])
            two.remove_building("late")
            two.add_building("latest", *make_building(model, 5))
        one.refresh()
        assert one.buildings == ("home", "later", "latest", "other")


def test_a_map_built_anew_with_another_model_refuses_the_late(empty: MilvusAddress) -> None:
    """Embeddings of two models in one map would be worthless; the number of dimensions may change too."""
    import torch

    from semloc_core.encoding.encoder import build_encoder
    from semloc_core.encoding.model import Model

    old = make_model()
    encoder = build_encoder("paper", {"hidden": 8, "dimension": 10, "heads": 1}, 3, torch.Generator().manual_seed(1))
    new = Model(encoder, old.labelspace)
    source = MilvusSource(empty, poll_s=0.0)
    with FleetDatabase.open(empty) as one, FleetDatabase.open(empty) as two:
        one.add_building("home", *make_building(old, 5))
        assert source.model().hash == old.hash

        def late() -> None:
            with one.transaction():
                one.add_building("late", *make_building(old, 5))
                with two.transaction():
                    two.reset(new)
                    two.add_building("fresh", *make_building(new, 8))

        with pytest.raises(MapError, match="built it anew meanwhile"):
            late()
        assert source.model().hash == new.hash
        assert list(source.catalogue().buildings) == ["fresh"]
        assert source.catalogue().dimension == 10
        assert source.nearest(make_building(new, 8)[3][2], 3).buildings == ("fresh",) * 3
        assert one.sweep(0) > 0
        assert len(source.fetch("fresh").places.ids) == 8
    source.close()


def test_removed_while_another_queries(empty: MilvusAddress) -> None:
    """A reader with the old catalogue gets what it fetches until a sweep; then one line, never half of it."""
    model = make_model()
    with FleetDatabase.open(empty) as database:
        database.add_building("a", *make_building(model, 9, 1))
        database.add_building("b", *make_building(model, 9, 2))
        source = MilvusSource(empty, poll_s=1e9)  # it would never ask by itself
        assert len(source.fetch("a").places.ids) == 9
        database.remove_building("a")
        assert len(source.fetch("a").places.ids) == 9
        database.sweep(0)
        with pytest.raises(MapError, match=r"one of the map's buildings: b \(got 'a'\)"):
            source.fetch("a")
        assert set(source.nearest(make_building(model, 9, 1)[3][0], 18).buildings) == {"b"}
        # One that was replaced and swept is found where it is now.
        stale = MilvusSource(empty, poll_s=1e9)
        assert len(stale.fetch("b").places.ids) == 9
        database.replace_building("b", *make_building(model, 12, 3))
        database.sweep(0)
        assert len(stale.fetch("b").places.ids) == 12
    source.close()
    stale.close()


def test_left_overs_are_swept_only_after_the_grace_time(empty: MilvusAddress, monkeypatch: pytest.MonkeyPatch) -> None:
    model = make_model()
    with FleetDatabase.open(empty) as database:
        database.add_building("a", *make_building(model, 5, 1))
        database.replace_building("a", *make_building(model, 6, 2))
        assert database.sweep(3600) == 0
        assert len(rows(empty)["places"]) == 2
        assert database.sweep(0) == 1
        assert len(rows(empty)["places"]) == 1
        with pytest.raises(MapError, match="grace time of at least 0 s"):
            database.sweep(-1)
        # What a writer that was asleep for longer than the grace time must notice.
        original = database._server.insert

        def slow(collection: str, some: list[dict[str, object]]) -> None:
            original(collection, some)
            with FleetDatabase.open(empty) as sweeper:
                sweeper.sweep(0)

        monkeypatch.setattr(database._server, "insert", slow)
        with pytest.raises(MapError, match="a sweep that took it"):
            database.replace_building("a", *make_building(model, 7, 3))
    source = MilvusSource(empty)
    assert len(source.fetch("a").places.ids) == 6
    source.close()
