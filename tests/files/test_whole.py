"""A file is there whole or not at all."""

import os
import random
import resource
import signal
from pathlib import Path

import pytest
from killing import Work, calls_of, run_and_kill

import semloc_core
from semloc_core.files.whole import write_whole

ROUNDS = int(os.environ.get("SEMLOC_SOAK", "0")) or 20  # set by `make soak`


def test_it_is_written_and_replaced_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "figures.json"
    write_whole(path, b"one")
    write_whole(str(path), b"two")
    assert path.read_bytes() == b"two"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_full_disk_refuses_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "figures.json"
    write_whole(path, b"one")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
        with pytest.raises(OSError, match="too large") as refused:
            write_whole(path, bytes(100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert refused.value.filename == str(path)
    assert path.read_bytes() == b"one"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_whole(tmp_path / "link", b"one")
    assert (tmp_path / "target").read_bytes() == b"one"
    assert (tmp_path / "link").is_symlink()
    (tmp_path / "loop").symlink_to("loop")
    write_whole(tmp_path / "loop", b"two")
    assert (tmp_path / "loop").read_bytes() == b"two"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_device_is_written_to_as_it_is(tmp_path):
    write_whole("/dev/null", b"one")
    with pytest.raises(OSError, match="No space"):
        write_whole("/dev/full", b"one")


def test_killed_while_it_is_written(tmp_path):
    """As figures and pages are: one of the two is there, whole, and nothing else that a glob would find."""
    path, contents = tmp_path / "page.html", (b"a" * 300_000, b"b" * 400_000)
    write_whole(path, contents[0])

    def work(given: Work) -> None:
        given.begun()
        for n in range(1, 4):
            write_whole(path, contents[n % 2])

    usual = calls_of(work)
    rng, found, left = random.Random(0), set(), 0
    for n in range(ROUNDS):
        run_and_kill(work, rng.randint(0, usual), just_there=n % 3 > 0)
        content = path.read_bytes()
        assert content in contents
        found.add(content)
        beside = [each for each in tmp_path.iterdir() if each != path]
        assert all(each.name.startswith(".page.html.") for each in beside)
        left += len(beside)
        for each in beside:
            each.unlink()
    assert left, "the kills came at rest"
    assert found == set(contents)


def test_an_interruption_leaves_nothing_beside_it(tmp_path, monkeypatch):
    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "figures.json"
    write_whole(path, b"one")
    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(path, b"two")
    assert path.read_bytes() == b"one"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_else_writes_files():
    """What a command writes goes through it; a bag or a trajectory is a log, and grows as it is written."""
    root, found = Path(semloc_core.__file__).parent, set()
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if any(way in text for way in (".write_bytes(", ".write_text(", ".savefig(path", "fdopen(", 'open("w')):
            found.add(path.relative_to(root).as_posix())
    in_temporary_folders = {"sources/bag/kinds.py", "benchmark/start.py"}
    assert found == {"files/whole.py", "sources/bag/writer.py", *in_temporary_folders}
