"""`semloc view` serves the page while a run is localised, or with the answers of a bag inside; and the first day."""

import json
from types import SimpleNamespace
from urllib.request import urlopen

import pytest

from semloc_core.cli import view as command


@pytest.fixture
def looked(monkeypatch) -> list[dict[str, str]]:
    """What a browser gets where the command waits for Ctrl-C."""
    said: list[str] = []
    found: list[dict[str, str]] = []

    def wait() -> None:
        address = said[0].split()[0]
        with urlopen(address) as page:
            pages = {"address": address, "page": page.read().decode()}
        if len(said) > 1:
            with urlopen(f"{address}frames?from=0") as frames:
                pages["frames"] = frames.read().decode()
        found.append(pages)
        said.clear()
        raise SystemExit(0)

    monkeypatch.setattr(command, "threading", SimpleNamespace(Event=lambda: SimpleNamespace(wait=wait)))
    monkeypatch.setattr(command, "console", SimpleNamespace(print=said.append))
    return found


def test_a_run_live_and_its_recorded_answers(semloc, write_corridor, tmp_path, looked) -> None:
    home = write_corridor(tmp_path / "home.json", ["chair", "couch", "bed", "toilet", "sink", "tv"])
    map_file, run, results = tmp_path / "home.map", tmp_path / "run.mcap", tmp_path / "results.mcap"
    for words in (
        ("map", "build", home, "-o", map_file),
        ("bag", "simulate", home, "-o", run, "--distance", 6),
        ("replay", run, "--map", map_file, "-o", results),
    ):
        done = semloc(*words)
        assert done.code == 0, done.err
    assert semloc("view", run, "--map", map_file).code == 0
    live = json.loads(looked[0]["frames"])
    assert looked[0]["address"].startswith("http://127.0.0.1:"), "nobody else is listened to"
    assert live["done"]
    assert live["error"] == ""
    assert len(live["frames"]) > 3
    assert semloc("view", results, "--run", run, "--map", map_file).code == 0
    assert "results.mcap" in looked[1]["page"]
    assert "frames" not in looked[1], "its frames are in the page"


def test_what_is_no_run_is_said_in_one_line(semloc, write_corridor, tmp_path) -> None:
    home = write_corridor(tmp_path / "home.json", ["chair", "couch"])
    assert semloc("map", "build", home, "-o", tmp_path / "home.map").code == 0
    said = semloc("view", tmp_path / "none.mcap", "--map", tmp_path / "home.map")
    assert said.code == 2
    assert "none.mcap" in said.err
    assert said.err.startswith("semloc: ")


def test_alone_it_prints_the_first_day_in_order(semloc) -> None:
    lines = semloc().out.splitlines()
    words = [line.split()[1] for line in lines if line.strip().startswith("semloc ")]
    assert words == ["world", "map", "bag", "replay", "view"]
