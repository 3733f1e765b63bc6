"""A file that is not a sound map, of another version, or no file at all gets one clear line."""

from __future__ import annotations

import os
import sqlite3
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from map_cases import ONE_LINE, make_building, make_map, make_model, same

from semloc_core.encoding.model import Model
from semloc_core.errors import MapError
from semloc_core.map_database import MapDatabase, describe, load
from semloc_core.map_database.stored import schema as map_schema
from semloc_core.map_database.stored.records import PackedGraph, pack_graph, unpack_graph


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model()


@pytest.fixture
def path(tmp_path: Path, model: Model) -> Path:
    """A map of two buildings, at rest."""
    return make_map(tmp_path / "site.map", model)


def edit(path: Path, *statements: str, values: tuple[object, ...] = ()) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement, values)


FORGED: dict[str, Callable[[Path], object]] = {
    "zero length": lambda p: p.write_bytes(b""),
    "random": lambda p: p.write_bytes(np.random.default_rng(0).bytes(50_000)),
    "a header and no more": lambda p: p.write_bytes(p.read_bytes()[:100]),
    "random after the header": lambda p: p.write_bytes(p.read_bytes()[:100] + np.random.default_rng(0).bytes(50_000)),
    "half": lambda p: p.write_bytes(p.read_bytes()[: p.stat().st_size // 2]),
    "last page missing": lambda p: p.write_bytes(p.read_bytes()[:-8192]),
    "newer": lambda p: edit(p, "PRAGMA user_version = 99"),
    "version 0": lambda p: edit(p, "PRAGMA user_version = 0"),
    "another program's": lambda p: edit(p, "PRAGMA application_id = 7"),
    "a trigger": lambda p: edit(p, "CREATE TRIGGER t AFTER INSERT ON place BEGIN DELETE FROM building; END"),
    "a schema in no encoding": lambda p: p.write_bytes(p.read_bytes().replace(b"TABLE b", b"T\xc5BLE b", 1)),
    "a table more": lambda p: edit(p, "CREATE TABLE more (x)"),
    "a table less": lambda p: edit(p, "DROP TABLE place"),
    "no meta": lambda p: edit(p, "DELETE FROM meta"),
    "dimension in words": lambda p: edit(p, "UPDATE meta SET value = 'six' WHERE key = 'dimension'"),
    "dimension zero": lambda p: edit(p, "UPDATE meta SET value = '0' WHERE key = 'dimension'"),
    "dimension huge": lambda p: edit(p, "UPDATE meta SET value = '1000000000' WHERE key = 'dimension'"),
    "other model hash": lambda p: edit(p, "UPDATE meta SET value = 'abc' WHERE key = 'model_hash'"),
    "other labelspace hash": lambda p: edit(p, "UPDATE meta SET value = 'abc' WHERE key = 'labelspace_hash'"),
    "other content hash": lambda p: edit(p, "UPDATE meta SET value = 'abc' WHERE key = 'content_hash'"),
    "no model": lambda p: edit(p, "DELETE FROM model"),
    "model of random bytes": lambda p: edit(p, "UPDATE model SET data = randomblob(5000)"),
    "model of text": lambda p: edit(p, "UPDATE model SET data = 'weights'"),
    "short embedding": lambda p: edit(p, "UPDATE place SET embedding = zeroblob(8) WHERE x = 1"),
    "text for an embedding": lambda p: edit(p, "UPDATE place SET embedding = 'abcdefghijklmnopqrstuvwx' WHERE x = 1"),
    "NaN embedding": lambda p: edit(p, "UPDATE place SET embedding = ?", values=(np.full(6, np.nan, "<f4").tobytes(),)),
    "changed embedding": lambda p: edit(p, "UPDATE place SET embedding = zeroblob(24) WHERE x = 1"),
    "moved place": lambda p: edit(p, "UPDATE place SET x = x + 1"),
    "infinite position": lambda p: edit(p, "UPDATE place SET x = 9e999"),
    "position in words": lambda p: edit(p, "UPDATE place SET x = 'north'"),
    "binary id": lambda p: edit(p, "UPDATE place SET id = CAST(id AS BLOB)"),
    "place lost": lambda p: edit(p, "DELETE FROM place WHERE x = 1"),
    "all places of a building lost": lambda p: edit(p, "DELETE FROM place WHERE building = 1"),
    "building renamed": lambda p: edit(p, "UPDATE building SET name = 'c' WHERE name = 'a'"),
    "building lost": lambda p: edit(p, "DELETE FROM building WHERE name = 'a'"),
    "no digest": lambda p: edit(p, "UPDATE building SET digest = NULL"),
    "building with a binary name": lambda p: edit(p, "UPDATE building SET name = CAST(name AS BLOB)"),
    "building named in no encoding": lambda p: edit(p, "UPDATE building SET name = CAST(x'FF' AS TEXT) WHERE id = 1"),
    "binary frame": lambda p: edit(p, "UPDATE building SET frame_id = x'00'"),
    "binary note": lambda p: edit(p, "UPDATE building SET source = x'00'"),
    "stamp in words": lambda p: edit(p, "UPDATE building SET stamp_ns = 'noon'"),
    "binary graph digest": lambda p: edit(p, "UPDATE building SET graph_digest = x'00'"),
    "binary meta": lambda p: edit(p, "UPDATE meta SET value = x'00'"),
    "graph of text": lambda p: edit(p, "UPDATE building SET graph = 'graph'"),
    "graph size in words": lambda p: edit(p, "UPDATE building SET graph_bytes = 'many'"),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_file_that_is_no_sound_map_gets_one_line(name: str, path: Path) -> None:
    FORGED[name](path)
    with pytest.raises(MapError, match=ONE_LINE):
        load(path)
    with pytest.raises(MapError, match=ONE_LINE):
        describe(path)


def test_any_changed_page_is_noticed_or_does_no_harm(path: Path) -> None:
    """Bytes overwritten at random: one line, or exactly the content that was committed; never anything else."""
    rng, before, sound = np.random.default_rng(0), load(path), path.read_bytes()
    refused, lines = 0, set[int]()
    for _ in range(90):
        data = bytearray(sound)
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 200))
        data[at : at + length] = rng.bytes(len(data[at : at + length]))
        path.write_bytes(bytes(data))
        try:
            loaded = load(path)
        except MapError as error:
            refused += 1
            lines.add(str(error).count("\n"))
        else:
            assert same(loaded, before)
    assert refused > 10
    assert lines == {0}


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("graph", zlib.compress(b"{}")),
        ("graph", b"not zlib"),
        ("graph", b""),
        ("graph", zlib.compress(bytes(50_000_000))),
        ("graph_bytes", 2**40),
        ("graph_bytes", 0),
        ("graph_bytes", -1),
    ],
)
def test_a_damaged_graph_is_refused_when_it_is_asked_for(path: Path, column: str, value: object) -> None:
    edit(path, f"UPDATE building SET {column} = ? WHERE name = 'a'", values=(value,))
    loaded = load(path)
    loaded.graph("b")
    with pytest.raises(MapError, match=ONE_LINE):
        loaded.graph("a")


def test_no_small_file_unpacks_to_much_and_what_is_stored_is_read(model: Model) -> None:
    """A graph that zlib would pack a hundred times is stored as it is; one that was packed so is not unpacked."""
    graph, long = make_building(model, 2)[0], "x" * 60_000
    graph.objects["o0"] = msgspec.structs.replace(graph.objects["o0"], class_=long)
    packed = pack_graph(graph, "map")
    assert len(packed.data) > packed.size > len(long)
    assert unpack_graph(packed).objects["o0"].class_ == long
    bomb = PackedGraph(packed.digest, packed.size, zlib.compress(zlib.decompress(packed.data)))
    with pytest.raises(MapError, match=ONE_LINE):
        unpack_graph(bomb)


def test_a_path_that_is_no_file_gets_one_line(tmp_path: Path, model: Model) -> None:
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "none.map", tmp_path / "no" / "folder.map", tmp_path / "fifo"):
        for use in (load, describe, MapDatabase.open):
            with pytest.raises(MapError, match=ONE_LINE):
                use(path)
    for path in (tmp_path, tmp_path / "no" / "folder.map"):
        with pytest.raises(MapError, match=ONE_LINE):
            MapDatabase.create(path, model)


def test_migrations_run_in_order_and_whole_or_not_at_all(path: Path) -> None:
    def note(text: str) -> map_schema.Migration:
        return lambda connection: connection.execute("INSERT INTO meta VALUES (?, ?)", (text, "")) and None

    with closing(map_schema.connect_to_write(path)) as connection:

        def notes() -> set[str]:
            return {key for (key,) in connection.execute("SELECT key FROM meta")} & {"one", "two"}

        now = map_schema.FORMAT_VERSION
        with pytest.raises(MapError, match=f"expected map format {now + 2} \\(got {now}"):
            map_schema.migrate(connection, path, now + 2, {now: note("one")})
        with pytest.raises(MapError, match=ONE_LINE):  # the same key again: fails
            map_schema.migrate(connection, path, now + 2, {now: note("one"), now + 1: note("one")})
        assert (map_schema.format_version(connection), notes()) == (now, set())
        map_schema.migrate(connection, path, now + 2, {now: note("one"), now + 1: note("two")})
        assert (map_schema.format_version(connection), notes()) == (now + 2, {"one", "two"})
        with pytest.raises(MapError, match=f"expected map format {now} \\(got {now + 2}"):
            map_schema.migrate(connection, path, now, {})
