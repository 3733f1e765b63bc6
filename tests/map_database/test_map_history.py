"""What a map knows of a building's past: stored, read back, bound by the hash, gone with the building."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from map_cases import ONE_LINE, make_building, make_map, make_model, same

from semloc_core.errors import MapError
from semloc_core.map_database import MapDatabase, describe, load
from semloc_core.map_database.history import MOVE_RATE, ClassChange, History, ObjectBelief, Traversal, move_rates
from semloc_core.map_database.stored.schema import FORMAT_VERSION
from semloc_core.sources.world import KINDS, draw_stacked

RUN = Traversal("run.mcap", 0.5, (1.0, 2.0, 0.0), 0.1, 3, 1, 2, 1, 0, 4)
HISTORY = History((RUN,), {"o0": ObjectBelief(0.3, 2, 4)}, {"chair": ClassChange(1.5, 2.5)})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_map(tmp_path / "m.map", make_model())


def revise(path: Path, history: History | None) -> None:
    with MapDatabase.open(path) as database:
        graph, _, positions, embeddings = make_building(make_model(), 9, 3)
        database.revise_building("a", graph, positions, embeddings, history)


def format_1(path: Path) -> None:
    """The same map as version 1 wrote it."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("DROP TABLE history")
        connection.execute("DROP TABLE storeys")
        connection.execute("PRAGMA user_version = 1")
        connection.execute("VACUUM")


def test_a_history_is_kept_and_is_part_of_the_hash(path):
    before = load(path)
    assert before.history("a") == History()
    revise(path, HISTORY)
    after = load(path)
    assert after.history("a") == HISTORY
    assert after.history("b") == History()
    assert len(after.place_ids) == len(before.place_ids) + 2
    revise(path, History())
    assert load(path).hash != after.hash, "what is believed of objects is content"
    revise(path, HISTORY)
    assert load(path).hash == after.hash
    revise(path, None)
    assert load(path).history("a") == HISTORY, "None leaves the history that is stored"


def test_a_history_goes_with_its_building(path):
    revise(path, HISTORY)
    with MapDatabase.open(path) as database:
        database.replace_building("a", *make_building(make_model(), 4, 5))
        assert database.history("a") == History()
        database.remove_building("a")
    assert load(path).buildings == ("b",)


def test_revising_leaves_source_and_frame(path):
    with MapDatabase.open(path) as database:
        graph, _, positions, embeddings = make_building(make_model(), 9, 3)
        database.revise_building("b", graph, positions, embeddings, HISTORY)
    (building,) = (each for each in describe(path)["buildings"] if each["name"] == "b")
    assert (building["source"], building["frame_id"], building["stamp_ns"]) == ("b.json", "b_map", -5)
    assert building["traversals"] == 1


def test_a_map_of_format_1_is_read_as_it_stands_and_migrated_when_written(path, tmp_path):
    """Maps in the field, some of them read-only, outlive a format."""
    before = load(path)
    format_1(path)
    old = shutil.copy(path, tmp_path / "m_old.map")
    as_it_stands = Path(old).read_bytes()
    assert same(load(old), before)
    assert load(old).history("a") == History()
    assert describe(old)["buildings"][0]["traversals"] == 0
    assert Path(old).read_bytes() == as_it_stands, "reading changes nothing"
    revise(path, HISTORY)
    assert load(path).history("a") == HISTORY
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (FORMAT_VERSION,)


def test_a_map_of_format_2_gets_its_storeys_and_keeps_its_hash(tmp_path):
    world, _ = draw_stacked(KINDS["home"], 2, np.random.default_rng(2))
    ids, model = sorted(world.graph.places), make_model()
    positions = np.array([world.graph.places[id_] for id_ in ids])
    path = tmp_path / "two.map"
    with MapDatabase.create(path, model) as database:
        database.add_building("a", world.graph, ids, positions, np.zeros((len(ids), model.encoder.dimension)))
    before = load(path)
    assert set(before.storeys.tolist()) == {0, 1}
    assert len(describe(path)["buildings"][0]["storeys"]) == 2
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("DROP TABLE storeys")
        connection.execute("PRAGMA user_version = 2")
    as_it_stands = load(path)
    assert as_it_stands.hash == before.hash
    np.testing.assert_array_equal(as_it_stands.storeys, before.storeys)
    MapDatabase.open(path).close()
    assert describe(path)["format_version"] == FORMAT_VERSION
    assert load(path).hash == before.hash
    np.testing.assert_array_equal(load(path).storeys, before.storeys)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE storeys SET data = zeroblob(length(data))")
    with pytest.raises(MapError, match=ONE_LINE):
        load(path)


@pytest.mark.parametrize("data", [b"{}x", b'{"objects": {"o0": {"persistence": 2}}}', b"\xff", 7])
def test_a_damaged_history_is_refused(path, data):
    revise(path, HISTORY)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE history SET data = ?", (data,))
    with pytest.raises(MapError, match=ONE_LINE):
        load(path)


def test_move_rates_shrink_to_the_rate_of_all_classes():
    unknown = move_rates([], ["chair"])["chair"]
    assert unknown == pytest.approx(MOVE_RATE)
    counts = {"chair": ClassChange(20, 80), "couch": ClassChange(100, 0)}
    rates = move_rates([counts], ["chair", "couch", "lamp"])
    assert 0.7 < rates["chair"] < 0.8
    assert rates["couch"] < 0.02
    assert rates["lamp"] == pytest.approx((4 * MOVE_RATE + 80) / 204), "a class never seen moves as classes do"
    few = move_rates([{**counts, "lamp": ClassChange(0, 1)}], ["lamp"])["lamp"]
    assert rates["lamp"] < few < 0.6, "one lamp that moved is no proof that lamps move"
    halves = {"chair": ClassChange(10, 40), "couch": ClassChange(50, 0)}
    assert move_rates([halves, halves], ["chair"])["chair"] == pytest.approx(rates["chair"]), "buildings are pooled"


def test_beliefs_out_of_range_are_no_history(path):
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(b'{"persistence": -0.1}', type=ObjectBelief)
