"""Every command on odd terminals, stopped early, unread; and refused before anything slow is imported."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from semloc_core.cli.commands import app

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and pipes are others there")
SLOW = ("torch", "scipy", "matplotlib", "sklearn")
RUN = [sys.executable, "-m", "semloc_core"]


def commands(command: object, words: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = [words]
    for name, other in getattr(command, "commands", {}).items():
        found += commands(other, (*words, name))
    return found


ALL = commands(typer.main.get_command(app))
REFUSED = [
    ("train", "X", "-o", "new.model"),
    ("introspect", "X"),
    ("map", "build", "X", "-o", "new.map"),
    ("map", "add", "X", "X"),
    ("map", "replace", "X", "X"),
    ("map", "remove", "X", "home"),
    ("map", "merge", "X", "X"),
    ("map", "info", "X"),
    ("map", "push", "X", "milvus+http://127.0.0.1:1/a"),
    ("bag", "simulate", "X", "-o", "new.mcap"),
    ("replay", "X", "--map", "X"),
    ("explain", "X", "X"),
    ("evaluate", "office", "X"),
    ("evaluate", "relocalise", "X"),
    ("evaluate", "online", "X"),
    ("evaluate", "candidates", "X"),
    ("evaluate", "layout", "X"),
    ("evaluate", "merge", "X"),
    ("evaluate", "trust", "X"),
    ("report", "replay", "X", "--map", "X", "-o", "new.html"),
    ("report", "study", "X", "-o", "new.html"),
    ("report", "picture", "X", "--map", "X", "-o", "new.png"),
    ("replay", "X", "--no-such-option"),
    ("world", "office", "-o", "no/such/folder/x.json"),
]


def run(words: tuple[str, ...], folder: Path, **variables: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*RUN, *words], capture_output=True, cwd=folder, env={**os.environ, **variables}, check=False)


def imported(words: tuple[str, ...], folder: Path) -> subprocess.CompletedProcess[bytes]:
    """The command, and at the end which slow modules it imported, as the last line of stdout."""
    script = (
        "import sys\nfrom semloc_core.cli import main\ntry:\n    main()\nfinally:\n"
        f"    print('slow:', *[name for name in {SLOW} if name in sys.modules])\n"
    )
    return subprocess.run([sys.executable, "-c", script, *words], capture_output=True, cwd=folder, check=False)


@pytest.mark.parametrize("words", REFUSED, ids=" ".join)
def test_refusals_import_nothing_slow(tmp_path: Path, words: tuple[str, ...]) -> None:
    said = imported(words, tmp_path)
    assert said.returncode == 2, said
    assert said.stderr.startswith(b"semloc: "), said
    assert said.stderr.count(b"\n") == 1, said
    assert said.stdout.split(b"slow:")[-1].strip() == b"", said


@pytest.mark.parametrize("words", ALL, ids=lambda words: " ".join(words) or "semloc")
def test_help_is_quick_and_fits_any_encoding_and_width(tmp_path: Path, words: tuple[str, ...]) -> None:
    said = imported((*words, "--help"), tmp_path)
    assert said.returncode == 0, said
    assert said.stdout.split(b"slow:")[-1].strip() == b"", said
    for encoding, columns in (("latin-1", "20"), ("ascii", "80"), ("cp1252", "400")):
        said = run((*words, "--help"), tmp_path, PYTHONIOENCODING=encoding, COLUMNS=columns, NO_COLOR="1")
        assert said.returncode == 0, said
        assert said.stderr == b"", said
        said.stdout.decode(encoding)


def test_letters_that_an_encoding_lacks_are_said_plainly() -> None:
    from semloc_core.cli.shared.ending import plainly

    text = "0–5 … é 🙂"
    assert plainly(UnicodeEncodeError("ascii", text, 0, len(text), "")) == ("0-5 ... e ?", len(text))


@POSIX
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stopped_while_modules_are_imported_it_says_one_line(tmp_path: Path, number: int, status: int) -> None:
    """At each of its own modules in turn: the signal comes while that is looked for, whatever the machine's speed."""
    script = (
        "import os, sys, importlib.abc\n"
        "class At(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        f"        if name == {{name!r}}: os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, At())\n"
        "from semloc_core.__main__ import command\ncommand()\n"
    )
    for name in ("semloc_core.cli.commands", "typer", "rich", "semloc_core.cli.world", "numpy"):
        said = subprocess.run(
            [sys.executable, "-c", script.format(name=name), "world", "office", "-o", "office.json"],
            capture_output=True,
            cwd=tmp_path,
            # In a shell's background a process is started to ignore SIGINT.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
            check=False,
        )
        assert (said.returncode, said.stdout, said.stderr) == (status, b"", b"semloc: interrupted\n"), (name, said)


@POSIX
@pytest.mark.parametrize("words", [("--help",), ("evaluate", "--help"), ("world", "home", "-o", "home.json")])
def test_nobody_reads(tmp_path: Path, words: tuple[str, ...]) -> None:
    read, write = os.pipe()
    os.close(read)
    said = subprocess.run([*RUN, *words], stdout=write, stderr=subprocess.PIPE, cwd=tmp_path, check=False)
    os.close(write)
    assert (said.returncode, said.stderr) == (141, b""), said
