"""What a person can get wrong in the words of a command: one line on stderr and exit status 2, no box, no page."""

import subprocess
import sys

import pytest

from semloc_core import __version__
from semloc_core.cli import main


def said(words: list[str], monkeypatch, capsys) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["semloc", *words])
    with pytest.raises(SystemExit) as stop:
        main()
    out, err = capsys.readouterr()
    return int(stop.value.code or 0), out, err


@pytest.mark.parametrize(
    ("words", "names", "help_of"),
    [
        (["explain", "a.map", "b.json", "--neer", "1,2"], "--neer", "semloc explain"),
        (["--bogus"], "--bogus", "semloc"),
        (["fly"], "fly", "semloc"),
        (["map", "fly"], "fly", "semloc map"),
        (["map", "build"], "GRAPH|RUN", "semloc map build"),
        (["replay", "run.mcap"], "--map", "semloc replay"),
        (["replay", "run.mcap", "--map", "a.map", "--top-n", "ten"], "--top-n", "semloc replay"),
        (["explain", "a.map", "b.json", "--near"], "--near", "semloc explain"),
        (["replay", "run.mcap", "--map", "a.map", "--top-n=1.5"], "a whole number (got '1.5')", "semloc replay"),
        (
            ["graph", "from-nav2", "a", "b", "-o", "c", "--radius", "50"],
            "at most 10 (got '50')",
            "semloc graph from-nav2",
        ),
        (["train", "a.json", "-o", "a.model", "--loss", "gain"], "infonce", "semloc train"),
        (["train", "a.json", "-o", "a.model", "--seed", "-1"], "--seed", "semloc train"),
    ],
)
def test_wrong_words_are_one_line_that_names_them_and_the_help(words, names, help_of, monkeypatch, capsys) -> None:
    code, out, err = said(words, monkeypatch, capsys)
    assert (code, out) == (2, "")
    assert err.startswith("semloc: ")
    assert len(err.splitlines()) == 1, err
    assert names in err
    assert f"(see {help_of} --help)" in err


@pytest.mark.parametrize("words", [[], ["map"], ["evaluate"]])
def test_no_words_at_all_print_the_help_alone(words, monkeypatch, capsys) -> None:
    code, out, err = said(words, monkeypatch, capsys)
    assert "Commands" in out + err
    assert code == 2
    assert "semloc:" not in err


def test_help_and_version_are_no_errors(monkeypatch, capsys) -> None:
    assert said(["--version"], monkeypatch, capsys) == (0, f"semloc {__version__}\n", "")
    assert said(["replay", "--help"], monkeypatch, capsys)[0] == 0


def test_the_module_is_the_command() -> None:
    """Else the help of one speaks of the other, and completion is installed for `python`."""
    done = subprocess.run([sys.executable, "-m", "semloc_core", "map", "fly"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "semloc: no such command 'fly' (see semloc map --help)\n"


def test_completion_knows_the_commands() -> None:
    words = {"_SEMLOC_COMPLETE": "complete_bash", "COMP_WORDS": "semloc re", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-m", "semloc_core"], capture_output=True, text=True, env=words)
    assert set(done.stdout.split()) == {"replay", "report"}, done.stderr


def test_stopping_it_is_said_in_a_line(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("semloc_core.sources.write_world", stopped)
    code, _, err = said(["world", "office", "-o", "office.json"], monkeypatch, capsys)
    assert (code, err.splitlines()[-1]) == (130, "semloc: interrupted")
