"""`semloc map info`: what is in a map, and which of its places look alike, whatever the encoder."""

import json
from pathlib import Path

import pytest


@pytest.fixture
def home(write_corridor, tmp_path) -> Path:
    return write_corridor(tmp_path / "home.json", ["chair", "couch", "chair", "bed", "chair", "chair"])


def built(semloc, tmp_path, *graphs: Path, model: str = "coco", more: tuple[str, ...] = ()) -> Path:
    done = semloc("map", "build", *graphs, "--model", model, "-o", tmp_path / "a.map", *more)
    assert done.code == 0, done.err
    return tmp_path / "a.map"


def lines(out: str) -> list[list[str]]:
    return [line.split() for line in out.splitlines()]


def test_the_first_lines_say_what_a_robot_is_trusted_to(semloc, home, tmp_path) -> None:
    told = semloc("map", "info", built(semloc, tmp_path, home))
    assert told.code == 0, told.err
    first = told.out.splitlines()
    assert first[0].startswith("map         a (")
    assert first[0].endswith("1 building, 6 places, 6 objects of 3 classes")
    assert [line.split()[0] for line in first[1:4]] == ["hash", "model", "labelspace"]
    assert len(first[1].split()[1]) == 64
    for row in (["home", "6", "6"], ["chair", "4"], ["couch", "1"], ["bed", "1"]):
        assert row in lines(told.out), row
    assert not any(word in told.out for word in ("┃", "…", "centres")), "no frame, nothing cut off, no options unasked"


def test_places_that_look_alike_are_counted_for_every_encoder(semloc, write_corridor, tmp_path) -> None:
    """Two copies of a building: no place has its kind for itself, and half of the answers are in the wrong one."""
    rooms = ["chair", "couch", "bed", "toilet", "sink", "tv", "vase", "book", "oven", "clock"]
    flat = write_corridor(tmp_path / "flat.json", rooms)
    map_file = built(semloc, tmp_path, flat)
    assert semloc("map", "add", map_file, flat, "--name", "copy").code == 0
    told = semloc("map", "info", map_file, "--json", tmp_path / "info.json")
    assert "class labels within 3 hops" in told.out
    assert "geodesic_attention reads distances too: to it this is no ceiling" in told.out
    rows = {row["scope"]: row for row in json.loads((tmp_path / "info.json").read_text())["rows"] if "colours" in row}
    assert (rows["flat"]["colours"], rows["flat"]["alone"], rows["flat"]["success@1_ceiling"]) == (10, 10, 1.0)
    assert (rows["all"]["places"], rows["all"]["alone"], rows["all"]["far_aliases"]) == (20, 0, 20)
    assert rows["all"]["success@1_ceiling"] == 0.5
    assert ["all", "20", "10", "0", "20", "0.500"] in lines(told.out)
    assert ["chair", "2", "2"] in lines(told.out), "objects of all buildings, and in how many of these"


def test_it_is_left_out_where_not_wanted_and_offered(semloc, home, tmp_path) -> None:
    told = semloc("map", "info", built(semloc, tmp_path, home), "--no-aliasing")
    assert "--aliasing says how many places look alike" in told.out
    assert "at most" not in told.out


def test_an_encoder_of_labels_gets_its_own_ceiling(semloc, home, tmp_path) -> None:
    model = tmp_path / "words.model"
    assert semloc("train", home, "-o", model, "--encoder", "bag_of_words").code == 0
    told = semloc("map", "info", built(semloc, tmp_path, home, model=str(model)))
    assert "class labels within" in told.out
    assert "no ceiling" not in told.out


def test_objects_that_the_model_does_not_know_are_counted(semloc, write_corridor, tmp_path) -> None:
    graph = write_corridor(tmp_path / "odd.json", ["chair", "desk", "desk", "whiteboard"])
    told = semloc("map", "info", built(semloc, tmp_path, graph, more=("--allow-unknown",)))
    assert "3 objects of classes that the model does not know: desk (2), whiteboard (1)" in told.out


def test_long_lists_classes_by_building_and_options(semloc, home, tmp_path) -> None:
    told = semloc("map", "info", built(semloc, tmp_path, home), "--long")
    assert "objects     home: chair 4, bed 1, couch 1" in told.out
    assert "centres" in told.out
