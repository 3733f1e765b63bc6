"""`semloc map info`: what is in a map, and which of its places look alike, whatever the encoder."""

import json
from pathlib import Path

import pytest

from semloc_core.cli.maps import info as map_info
from semloc_core.cli.maps.info import _moving


@pytest.fixture
def home(write_corridor, tmp_path) -> Path:
    return write_corridor(tmp_path / "home.json", ["chair", "couch", "chair", "bed", "chair", "chair"])


def built(semloc, tmp_path, *graphs: Path, model: str = "general", more: tuple[str, ...] = ()) -> Path:
    done = semloc("map", "build", *graphs, "--model", model, "-o", tmp_path / "a.map", *more)
    assert done.code == 0, done.err
    return tmp_path / "a.map"


def lines(out: str) -> list[list[str]]:
    return [line.split() for line in out.splitlines()]


def test_the_first_lines_say_what_a_robot_is_trusted_to(semloc, home, tmp_path) -> None:
    told = semloc("map", "info", built(semloc, tmp_path, home))
    assert told.code == 0, told.err
    first = told.out.splitlines()
    assert first[0] == "a: 1 building, 6 places, 6 objects of 3 classes"
    assert first[1:4] == [
        "- Storeys: one.",
        "- Look-alikes: no other building or storey is in this map; of this one's places 0% are like another far off "
        "in it.",
        "- Objects: half of the places have 6 or more within 5 m; none has none.",
    ]
    for row in (
        ["home", "6", "6", "1", *["0.0", "to", "5.0", "0.0", "to", "0.0", "0.0", "to", "0.0"]],
        ["chair", "4"],
        ["couch", "1"],
        ["bed", "1"],
    ):
        assert row in lines(told.out), row
    assert not any(word in told.out for word in ("┃", "…", "centres", "hash", "1-WL")), (
        "no frame, nothing cut off, no jargon"
    )


def test_places_that_look_alike_are_counted_for_every_encoder(semloc, write_corridor, tmp_path) -> None:
    """Two copies of a building: no place has its kind for itself, and half of the answers are in the wrong one."""
    rooms = ["chair", "couch", "bed", "toilet", "sink", "tv", "vase", "book", "oven", "clock"]
    flat = write_corridor(tmp_path / "flat.json", rooms)
    map_file = built(semloc, tmp_path, flat)
    assert semloc("map", "add", map_file, flat, "--name", "copy").code == 0
    told = semloc("map", "info", map_file, "--long", "--json", tmp_path / "info.json")
    assert "class labels within 3 hops" in told.out
    assert "geodesic_attention reads distances too: to it this is no ceiling" in told.out
    rows = {row["scope"]: row for row in json.loads((tmp_path / "info.json").read_text())["rows"] if "colours" in row}
    assert (rows["flat"]["colours"], rows["flat"]["alone"], rows["flat"]["success@1_ceiling"]) == (10, 10, 1.0)
    assert (rows["all"]["places"], rows["all"]["alone"], rows["all"]["far_aliases"]) == (20, 0, 20)
    assert rows["all"]["success@1_ceiling"] == 0.5
    assert ["all", "20", "10", "0", "20", "0.500"] in lines(told.out)
    assert ["chair", "2", "2"] in lines(told.out), "objects of all buildings, and in how many of these"


def test_it_is_left_out_where_not_wanted_and_offered_where_it_takes_long(semloc, home, tmp_path, monkeypatch) -> None:
    map_file = built(semloc, tmp_path, home)
    assert "alike" not in semloc("map", "info", map_file, "--no-aliasing", "--long").out
    monkeypatch.setattr(map_info, "UNASKED_PLACES", 5)
    told = semloc("map", "info", map_file)
    assert "--aliasing says which buildings look alike" in told.out
    assert "Objects:" not in told.out
    assert "Objects:" in semloc("map", "info", map_file, "--aliasing").out


def test_only_classes_that_move_are_said_to() -> None:
    assert _moving({"wall": 0.0, "sink": 0.01}) == "no class is seen to move"
    assert _moving({"sink": 0.01, "chair": 0.3, "couch": 0.05}) == "share that moves: chair 0.30, couch 0.05"
    assert _moving({f"c{i}": 0.2 for i in range(10)}).endswith("c7 0.20, and 2 more")


def test_one_is_one_and_a_long_name_does_not_widen_the_table(semloc, write_corridor, tmp_path) -> None:
    one = write_corridor(tmp_path / "one.json", ["chair"])
    map_file = built(semloc, tmp_path, one, more=("--name", "a" * 200))
    told = semloc("map", "info", map_file)
    assert "1 building, 1 place, 1 object of 1 class\n" in told.out
    assert ["a" * 59 + "…", "1", "1", "1"] in [line[:4] for line in lines(told.out)]
    assert "y: 1 place added\n" in semloc("map", "add", map_file, one, "--name", "y").out


def test_an_encoder_of_labels_gets_its_own_ceiling(semloc, home, tmp_path) -> None:
    model = tmp_path / "words.model"
    assert semloc("train", home, "-o", model, "--encoder", "bag_of_words").code == 0
    told = semloc("map", "info", built(semloc, tmp_path, home, model=str(model)), "--long")
    assert "class labels within" in told.out
    assert "no ceiling" not in told.out


def test_objects_that_the_model_does_not_know_are_counted(semloc, write_corridor, tmp_path) -> None:
    graph = write_corridor(tmp_path / "odd.json", ["chair", "desk", "desk", "whiteboard"])
    told = semloc("map", "info", built(semloc, tmp_path, graph, more=("--labelspace", "coco", "--allow-unknown")))
    assert "3 objects of classes that the model does not know: desk (2), whiteboard (1)" in told.out


def test_long_lists_classes_by_building_and_options(semloc, home, tmp_path) -> None:
    told = semloc("map", "info", built(semloc, tmp_path, home), "--long")
    assert "objects     home: chair 4, bed 1, couch 1" in told.out
    assert "centres" in told.out
    said = [line.split()[0] for line in told.out.splitlines() if line]
    assert {"file", "hash", "model", "labelspace", "alike"} <= set(said)
    assert said.index("-") < said.index("building") < said.index("hash"), "words first"


def test_twin_buildings_are_named_and_others_are_not(semloc, write_corridor, tmp_path) -> None:
    rooms = ["chair", "couch", "bed", "toilet", "sink", "tv", "vase", "book", "oven", "clock"] * 2
    flat = write_corridor(tmp_path / "flat.json", rooms)
    other = write_corridor(tmp_path / "other.json", rooms[3:13:2] + rooms[::3] + rooms[1::4])
    map_file = built(semloc, tmp_path, flat, other)
    told = semloc("map", "info", map_file, "--json", tmp_path / "one.json")
    assert "- Look-alikes: no building or storey is the twin of another.\n" in told.out
    assert semloc("map", "add", map_file, flat, "--name", "copy").code == 0
    told = semloc("map", "info", map_file, "--json", tmp_path / "two.json")
    assert "- Look-alikes: copy = flat. Expect `ambiguous` there" in told.out
    assert "- Needs: the classes of the" in told.out
    rows = [json.loads((tmp_path / name).read_text())["rows"] for name in ("one.json", "two.json")]
    twins = [{row["scope"]: row["twins"] for row in found if "twins" in row} for found in rows]
    assert twins == [{"flat": "", "other": ""}, {"copy": "flat", "flat": "copy", "other": ""}]


def test_where_a_building_lies_is_said_so_that_a_point_in_it_can_be_named(semloc, write_corridor, tmp_path) -> None:
    far = tmp_path / "far.json"
    moved = json.loads(write_corridor(tmp_path / "home.json", ["chair", "couch", "bed"]).read_text())
    for node in moved["nodes"]:
        x, y, z = node["attributes"]["position"]
        node["attributes"]["position"] = [x - 40.25, 2 * y - 0.02, z - 1.5]
    far.write_text(json.dumps(moved))
    told = semloc("map", "info", built(semloc, tmp_path, far), "--json", tmp_path / "info.json")
    extent = ["-40.2", "to", "-38.2", "0.0", "to", "0.0", "-1.5", "to", "-1.5"]
    assert ["far", "3", "3", "1", *extent] in lines(told.out)
    row = json.loads((tmp_path / "info.json").read_text())["rows"][0]
    assert [row[f"{axis}_{end}_m"] for axis in "xyz" for end in ("from", "to")] == [
        -40.25,
        -38.25,
        -0.02,
        -0.02,
        -1.5,
        -1.5,
    ]
    asked = semloc("explain", tmp_path / "a.map", far, "--near", f"{row['x_from_m']},{row['y_from_m']}")
    assert asked.code == 0, asked.err
