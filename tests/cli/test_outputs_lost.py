"""Two commands that write one map, and a command that is stopped: what is left is whole, and of one of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from semloc_core import map_merge
from semloc_core.cli.maps import commands as maps
from semloc_core.cli.shared import choose_model
from semloc_core.map_database import load


def _another(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "semloc_core", *map(str, words)], check=True, capture_output=True)


@pytest.fixture
def homes(write_corridor: Callable[..., Path], tmp_path: Path) -> tuple[Path, Path]:
    mine, theirs = tmp_path / "mine.json", tmp_path / "theirs.json"
    return write_corridor(mine, ["chair", "couch"] * 3), write_corridor(theirs, ["chair", "bed"] * 4)


def test_a_build_that_lost_the_race_says_so(semloc, homes, tmp_path, monkeypatch) -> None:
    """The other process begins after ours and is done before it."""
    mine, theirs = homes
    output, put = tmp_path / "a.map", map_merge.put_building

    def slow(*given: object, **options: object) -> int:
        _another("map", "build", theirs, "--model", "general", "-o", output)
        return put(*given, **options)

    monkeypatch.setattr(map_merge, "put_building", slow)
    said = semloc("map", "build", mine, "--model", "general", "-o", output)
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1), said
    assert "another process has written meanwhile" in said.err
    assert load(output).buildings == ("theirs",)
    assert {each.name for each in tmp_path.iterdir()} == {"mine.json", "theirs.json", "a.map"}


@pytest.mark.parametrize("first", [True, False])
def test_a_rebuild_that_lost_the_race_says_so(semloc, homes, tmp_path, monkeypatch, first) -> None:
    """Whether there was a map already, or none when ours began."""
    mine, theirs = homes
    output, chosen = tmp_path / "a.map", choose_model.choose_model
    if first:
        assert semloc("map", "build", mine, "--model", "general", "-o", output).code == 0

    def slow(*given: object, **options: object) -> object:
        _another("map", "build", theirs, "--model", "general", "-o", output, "--force")
        return chosen(*given, **options)

    monkeypatch.setattr(maps, "choose_model", slow)
    said = semloc("map", "build", mine, "--model", "general", "-o", output, "--force")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1), said
    assert "another process has written meanwhile" in said.err
    assert load(output).buildings == ("theirs",)


STOPPED = """
import os, signal, sys
from semloc_core import map_merge
from semloc_core.__main__ import command

def put(*given, **options):
    os.write(1, b"at work\\n")
    while True:
        signal.pause()

map_merge.put_building = put
command()
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("there", [False, True])
def test_a_build_that_is_stopped_leaves_what_was_there(semloc, homes, tmp_path, number, status, there) -> None:
    mine, theirs = homes
    output = tmp_path / "a.map"
    if there:
        assert semloc("map", "build", theirs, "--model", "general", "-o", output).code == 0
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    words = ["map", "build", str(mine), "--model", "general", "-o", str(output), "--force"]
    # In a shell's background a process is started to ignore SIGINT.
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as build:
        assert build.stdout is not None
        assert build.stderr is not None
        assert build.stdout.readline() == b"at work\n"
        build.send_signal(number)
        assert build.stderr.read() == b"semloc: interrupted\n"
        assert build.wait() == status
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == before
