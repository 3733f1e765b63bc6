"""Several processes on one map file, full disks, and files that can only be read."""

from __future__ import annotations

import os
import sqlite3
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from map_cases import ONE_LINE, Building, make_building, make_map, make_model, same

from semloc_core.encoding.model import Model
from semloc_core.errors import MapError
from semloc_core.map_database import MapDatabase, describe, load
from semloc_core.map_database.stored import schema as map_schema


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model()


@pytest.fixture
def path(tmp_path: Path, model: Model) -> Path:
    """A map of two buildings, at rest."""
    return make_map(tmp_path / "site.map", model)


def test_readers_and_a_writer_do_not_wait_for_each_other(path: Path, model: Model) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as reader:
        reader.execute("BEGIN")
        count = "SELECT count(*) FROM building"
        assert reader.execute(count).fetchone() == (2,)
        with MapDatabase.open(path) as database:
            database.add_building("c", *make_building(model, 3))  # while the reader reads
            with database.transaction():
                database.add_building("d", *make_building(model, 3))
                assert load(path).buildings == ("a", "b", "c")  # while the writer writes
        assert reader.execute(count).fetchone() == (2,)
    assert load(path).buildings == ("a", "b", "c", "d")
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_writers_and_readers_in_many_threads_lose_nothing(path: Path, model: Model) -> None:
    building, failures = make_building(model, 5), []

    def write(writer: int) -> None:
        try:
            for i in range(6):
                with MapDatabase.open(path) as database:
                    database.add_building(f"{writer}-{i}", *building)
        except BaseException as error:
            failures.append(error)

    def look() -> None:
        try:
            for _ in range(25):
                load(path)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=write, args=(i,)) for i in range(4)]
    threads += [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert len(load(path).buildings) == 2 + 4 * 6
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_a_writer_that_waits_too_long_says_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_schema, "BUSY_TIMEOUT_S", 0.05)
    with MapDatabase.open(path) as first, MapDatabase.open(path) as second, first.transaction():
        held = pytest.raises(MapError, match="another writer")
        with held:
            second.remove_building("a")


def fill(database: MapDatabase, building: Building, name: str) -> None:
    for i in range(10_000):
        database.add_building(f"{name}-{i}", *building)


def test_a_full_disk_keeps_the_old_state(path: Path, model: Model) -> None:
    """SQLite's own limit on pages, which it reports as it reports a full disk."""
    with MapDatabase.open(path) as database:
        (pages,) = database._connection.execute("PRAGMA page_count").fetchone()
        database._connection.execute(f"PRAGMA max_page_count = {pages + 5}")
        with pytest.raises(MapError, match="full disk"):
            fill(database, make_building(model, 12), "first")
        kept = database.buildings
        loaded = load(path)

        def go_on_after_the_failure() -> None:
            with database.transaction():
                with pytest.raises(MapError, match="full disk"):
                    fill(database, make_building(model, 12), "second")
                database.remove_building("a")  # the transaction is gone: this must not be a change of its own

        with pytest.raises(MapError, match=ONE_LINE):
            go_on_after_the_failure()
        assert same(load(path), loaded)
    assert load(path).buildings == kept
    assert set(kept) >= {"a", "b"}


def test_a_write_that_the_system_refuses_keeps_the_old_state(path: Path, model: Model) -> None:
    """A limit on file size makes write(2) itself fail part-way."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with MapDatabase.open(path) as database:
        building = make_building(model, 12)
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, hard))
            with pytest.raises(MapError, match=ONE_LINE):
                fill(database, building, "first")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        kept = database.buildings
        assert load(path).buildings == kept
        database.add_building("after", *building)
    assert set(load(path).buildings) == {*kept, "after"}
    assert set(kept) >= {"a", "b"}


@contextmanager
def folder_that_can_not_be_written() -> Iterator[tuple[Path, Callable[[], None]]]:
    """A folder, and what to call to make it read-only: for root, who may write anywhere, by being nobody."""
    root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def close() -> None:
            for each in folder.iterdir():
                each.chmod(0o444)
            folder.chmod(0o555)
            if root:
                os.setegid(65534)
                os.seteuid(65534)

        try:
            yield folder, close
        finally:
            if root:
                os.seteuid(0)
                os.setegid(0)
            folder.chmod(0o755)


def test_a_read_only_map_in_a_read_only_folder_can_be_read_but_not_changed(path: Path, model: Model) -> None:
    before = load(path)
    with folder_that_can_not_be_written() as (folder, close):
        copy = folder / path.name
        copy.write_bytes(path.read_bytes())
        close()
        assert same(load(copy), before)
        assert describe(copy)["hash"] == before.hash
        with pytest.raises(MapError, match=ONE_LINE), MapDatabase.open(copy) as database:
            database.remove_building("a")
        with pytest.raises(MapError, match=ONE_LINE):
            MapDatabase.create(folder / "new.map", model)
        assert [each.name for each in folder.iterdir()] == [copy.name]


def test_an_unfinished_log_in_a_read_only_folder_is_not_passed_over(path: Path, model: Model) -> None:
    """Reading the bare file there would serve an older state than the one committed."""
    with folder_that_can_not_be_written() as (folder, close):
        copy = folder / path.name
        with MapDatabase.open(path) as database:
            database.remove_building("a")
            for suffix in ("", "-wal"):
                Path(f"{copy}{suffix}").write_bytes(Path(f"{path}{suffix}").read_bytes())
        close()
        with pytest.raises(MapError, match="unfinished log"):
            load(copy)
