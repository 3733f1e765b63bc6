"""A file is there whole or not at all."""

import resource
import signal
from pathlib import Path

import pytest

from semloc_core.whole_file import write_whole


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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_device_is_written_to_as_it_is(tmp_path):
    write_whole("/dev/null", b"one")
    with pytest.raises(OSError, match="No space"):
        write_whole("/dev/full", b"one")
