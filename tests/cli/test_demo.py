"""`semloc demo` replays what is shipped, and draws it."""

from pathlib import Path

import pytest

from semloc_core.cli import commands


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
