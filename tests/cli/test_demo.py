"""`semloc demo` replays what is shipped, and draws it."""

from pathlib import Path

import pytest

from semloc_core.cli import commands
from semloc_core.cli.demo import AFTER, FILES
from semloc_core.config import LocaliserConfig
from semloc_core.map_database import load
from semloc_core.replay import replay


@pytest.mark.parametrize("force", [False, True])
def test_the_shipped_run_is_replayed_and_drawn(semloc, monkeypatch, tmp_path, force) -> None:
    asked: list[list[str]] = []
    run = commands.run

    def other(words: list[str]) -> int:
        if words[0] == "demo":
            return run(words)
        asked.append(words)
        return 0

    monkeypatch.setattr(commands, "run", other)
    said = semloc("demo", "-o", tmp_path / "shown", *["--force"] * force)
    assert said.code == 0, said.err
    assert [words[0] for words in asked] == ["replay", "report"]
    shipped = [Path(word) for words in asked for word in words if "demo_files" in word]
    assert {path.name for path in shipped} == {"demo.map", "demo_run.mcap"}
    assert all(path.stat().st_size > 100_000 for path in shipped)
    assert all(("--force" in words) is force for words in asked)
    assert str(tmp_path / "shown" / "report.html") in said.out
    assert AFTER in said.out


def test_the_shipped_run_is_what_is_said_of_it() -> None:
    answers: list[tuple[str, str | None, bool | None, str]] = []

    def scored(matches, truth, right) -> None:
        best = matches.matches[0].map if matches.matches else ""
        answers.append((matches.status, truth.frame_id if truth else None, right, best))

    config = LocaliserConfig(explain_rate_hz=0)
    replay(FILES / "demo_run.mcap", load(FILES / "demo.map"), config, on_scored=scored)
    frames = [frame for _, frame, _, _ in answers]
    assert list(dict.fromkeys(frames)) == ["office", "twin", "foreign"]
    found = [status for status, *_ in answers].index("match")
    assert frames[found] == "office"
    assert found >= 20, "in the dark, ten seconds"
    wrong = [(frame, best) for status, frame, right, best in answers if status == "match" and not right]
    assert set(wrong) <= {("office", "twin"), ("twin", "office")}
    twin = frames.index("twin")
    assert answers[twin][0] != "match"
    assert "match" in {status for status, frame, _, _ in answers if frame == "twin"}, "carried off, and found again"
    last = [status for status, frame, _, _ in answers if frame == "foreign"]
    assert "match" not in last
    assert last.count("ambiguous") > len(last) / 2


def test_what_goes_wrong_ends_it(semloc, monkeypatch, tmp_path) -> None:
    run = commands.run
    monkeypatch.setattr(commands, "run", lambda words: run(words) if words[0] == "demo" else 2)
    assert semloc("demo", "-o", tmp_path / "shown").code == 2


@pytest.mark.parametrize("file", ["results.mcap", "figures.json", "report.html", "run.mcap"])
def test_what_is_there_is_found_before_a_word_is_said(semloc, write_corridor, monkeypatch, tmp_path, file) -> None:
    run = commands.run
    monkeypatch.setattr(commands, "run", lambda words: run(words) if words[0] == "demo" else 0)
    home = write_corridor(tmp_path / "home.json", ["chair", "couch"])
    folder = tmp_path / "shown"
    folder.mkdir()
    (folder / file).write_text("mine")
    said = semloc("demo", home, "-o", folder)
    assert (said.code, said.out) == (2, "")
    assert f"(got {folder / file}, which is text)" in said.err
    assert semloc("demo", home, "-o", folder, "--force").code == 2, "of another kind"
    assert (semloc("demo", "-o", folder).code == 0) == (file == "run.mcap"), "that one is made of a building alone"
