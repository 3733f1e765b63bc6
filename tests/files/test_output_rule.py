"""The rule for what is written, kind by kind, and what another process writes meanwhile."""

from __future__ import annotations

import io
import os
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from semloc_core.errors import BagError, ConfigError
from semloc_core.files import kinds as file_kinds
from semloc_core.files.kinds import kind_of
from semloc_core.files.outputs import Output, guarded
from semloc_core.files.whole import write_whole
from semloc_core.sources.bag.writer import BagWriter


def _archive(first: str) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr(first, "{}")
    return data.getvalue()


def _database(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()


def _bag(path: Path) -> None:
    with BagWriter(path) as bag:
        bag.write_string("/a", 1, "x")


def _fail(bag: BagWriter, file: Path, before: bytes) -> None:
    """Halfway."""
    bag.write_string("/b", 1, "y")
    assert file.read_bytes() == before
    raise ZeroDivisionError


def _bytes(data: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(data)


MAKE: dict[str, tuple[Callable[[Path], object], ...]] = {
    file_kinds.MAP: (
        lambda path: _database(path, f"PRAGMA application_id = {file_kinds.APPLICATION_ID}", "CREATE TABLE a (b)"),
    ),
    file_kinds.BAG: (
        _bag,
        lambda path: _database(path, "CREATE TABLE topics (a)", "CREATE TABLE messages (a)"),
        _bytes(b'{"schema":"semloc/scene_graph_update/1","seq":0}\n{"schema":"semloc/scene_graph_update/1","seq":1}\n'),
    ),
    file_kinds.MODEL: (_bytes(_archive("header.json")),),
    file_kinds.STATE: (_bytes(_archive("state/data.pkl")),),
    file_kinds.GRAPH: (
        _bytes(b'{"nodes": [], "edges": []}'),
        _bytes(b'\xef\xbb\xbf {"edges": [], "nodes": [], "x": 1}'),
    ),
    file_kinds.FIGURES: (_bytes(b'{"command": "a", "seed": 0, "inputs": [], "rows": []}'),),
    file_kinds.MESSAGES: (_bytes(b'[{"schema": "semloc/place_matches/1"}]'),),
    file_kinds.STUDY: (_bytes(b'{"format": "semloc/page/1"}'),),
    file_kinds.CALIBRATION: (_bytes(b'{"features": [], "right": [], "in_map": []}'),),
    file_kinds.PAGE: (_bytes(b"<!DOCTYPE html><html></html>"),),
    file_kinds.PICTURE: (_bytes(b"\x89PNG\r\n\x1a\n0"), _bytes(b"<svg xmlns=''></svg>"), _bytes(b"%PDF-1.7")),
    file_kinds.TRAJECTORY: (_bytes(b"1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n"),),
    "": (
        _bytes(b"dear diary\n"),
        _bytes(b"\x7fELF\0\xff\xfe"),
        _bytes(b"[1, 2]"),
        _bytes(b'{"mine": 1}'),
        _bytes(_archive("thesis.docx")),
        lambda path: _database(path, "CREATE TABLE accounts (a)"),
    ),
}
CASES = [(kind, number) for kind, made in MAKE.items() for number in range(len(made))]


@pytest.mark.parametrize(("kind", "number"), CASES)
def test_what_is_there_is_replaced_by_its_own_kind_alone(tmp_path: Path, kind: str, number: int) -> None:
    path = tmp_path / "run.mcap"  # a name that says nothing
    MAKE[kind][number](path)
    assert not kind or kind_of(path) == kind
    for other in MAKE:
        if other and other != kind:
            with pytest.raises(ConfigError, match="which is"), guarded([Output("-o", path, other)], [], force=True):
                pass
    if kind:
        with pytest.raises(ConfigError, match="--force"), guarded([Output("-o", path, kind)], [], force=False):
            pass
        with guarded([Output("-o", path, kind)], [], force=True):
            pass


def test_two_outputs_are_two_files(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "old").write_bytes(b"")
    os.link(tmp_path / "old", tmp_path / "hard")
    a = Output("-o", tmp_path / "a", file_kinds.MODEL)
    pairs = [
        (a, Output("--json", tmp_path / "a", file_kinds.FIGURES)),
        (a, Output("--json", tmp_path / "link", file_kinds.FIGURES)),
        (a, Output("--json", tmp_path / "sub" / ".." / "a", file_kinds.FIGURES)),
        *[(Output("-o", tmp_path / "old", "a"), Output("--json", tmp_path / "hard", file_kinds.FIGURES))],
        (Output("-o", tmp_path / "bag", file_kinds.BAG), Output("--json", tmp_path / "bag", file_kinds.FIGURES)),
    ]
    (tmp_path / "sub").mkdir()
    for one in pairs:
        for outputs in (one, one[::-1]):
            with pytest.raises(ConfigError), guarded(outputs, [], force=True):
                pass
    with guarded([a, Output("--json", tmp_path / "b", file_kinds.FIGURES)], [], force=False):
        pass


def test_streams_take_what_comes_and_no_map(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    streams = [Path("/dev/stdout"), Path("/dev/null"), fifo]
    with guarded([Output(f"-{i}", path, file_kinds.FIGURES) for i, path in enumerate(streams)], [], force=False):
        write_whole("/dev/null", b"figures")
    for path in streams:
        with pytest.raises(ConfigError, match="a map"), guarded([Output("-o", path, file_kinds.MAP)], [], force=True):
            pass


@pytest.mark.parametrize("there", [False, True])
def test_what_another_writes_meanwhile_stays(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "page.html"
    if there:
        path.write_bytes(b"<html>before")
    with guarded([Output("-o", path, file_kinds.PAGE)], [], force=True):
        path.write_bytes(b"<html>another's, done first")
        with pytest.raises(FileExistsError, match="another process"):
            write_whole(path, b"<html>ours")
    assert path.read_bytes() == b"<html>another's, done first"
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]


def test_a_command_may_write_its_own_again(tmp_path: Path) -> None:
    with guarded([Output("--resume", tmp_path / "a", file_kinds.STATE)], [], force=False):
        write_whole(tmp_path / "a", b"1")
        write_whole(tmp_path / "a", b"2")
    assert (tmp_path / "a").read_bytes() == b"2"


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_a_bag_is_replaced_when_the_new_one_is_whole(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    _bag(path)
    file = path / "run_0.mcap" if path.is_dir() else path
    before = file.read_bytes()
    wanted = Output("-o", path, file_kinds.BAG)
    with guarded([wanted], [], force=True), pytest.raises(ZeroDivisionError), BagWriter(path) as bag:
        _fail(bag, file, before)
    assert file.read_bytes() == before
    with guarded([wanted], [], force=True), BagWriter(path) as bag:
        bag.write_string("/b", 1, "y")
    assert file.read_bytes() != before
    assert [each.name for each in tmp_path.iterdir()] == [name]
    after = file.read_bytes()
    with guarded([wanted], [], force=True), pytest.raises(BagError, match="another process"), BagWriter(path) as bag:
        os.utime(bag.path, ns=(1, 1))
    assert file.read_bytes() == after
    assert [each.name for each in tmp_path.iterdir()] == [name]
