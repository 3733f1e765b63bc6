"""A building of another labelspace must not slip into a map, nor numbers be read as classes without a word."""

import json
import sqlite3
from pathlib import Path

import pytest

HOME = ["chair", "couch", "bed", "chair"]
OFFICE = ["desk", "whiteboard", "desk", "chair"]


@pytest.fixture
def home_map(semloc, write_corridor, tmp_path) -> Path:
    home = write_corridor(tmp_path / "home.json", HOME)
    built = semloc("map", "build", home, "--labelspace", "coco", "-o", tmp_path / "home.map")
    assert built.code == 0, built.err
    return tmp_path / "home.map"


def without_names(path: Path) -> Path:
    """The same file as Hydra 1.0 wrote it: numbers in place of classes."""
    document = json.loads(path.read_text())
    document["metadata"] = {}
    for node in document["nodes"]:
        node["attributes"].pop("name", None)
    path.write_text(json.dumps(document))
    return path


def test_a_building_that_is_mostly_unknown_is_refused_with_its_classes_and_what_helps(
    semloc, write_corridor, home_map, tmp_path
) -> None:
    office = write_corridor(tmp_path / "office.json", OFFICE)
    before = home_map.read_bytes()
    for words in (("add", home_map, office), ("replace", home_map, office, "--name", "home")):
        refused = semloc("map", *words)
        assert refused.code == 2, refused.out
        assert len(refused.err.splitlines()) == 1, refused.err
        assert "got 1 of 4 in" in refused.err
        assert "desk (2), whiteboard (1)" in refused.err
        assert "--allow-unknown" in refused.err
        assert "--synonyms" in refused.err
        assert home_map.read_bytes() == before
    refused = semloc("map", "build", office, "--labelspace", "coco", "-o", tmp_path / "new.map")
    assert refused.code == 2
    assert "desk (2)" in refused.err
    assert not (tmp_path / "new.map").exists()
    assert semloc("map", "build", office, "-o", tmp_path / "new.map").code == 0, "by its own names it is a map"


def test_it_is_taken_where_that_is_meant(semloc, write_corridor, home_map, tmp_path) -> None:
    office = write_corridor(tmp_path / "office.json", OFFICE)
    added = semloc("map", "add", home_map, office, "--allow-unknown")
    assert added.code == 0, added.err
    assert "desk (2), whiteboard (1)" in added.err, "what is left out is still said"


def test_a_few_unknown_objects_are_said_and_taken(semloc, write_corridor, home_map, tmp_path) -> None:
    other = write_corridor(tmp_path / "other.json", ["chair", "couch", "desk", "whiteboard"])
    added = semloc("map", "add", home_map, other)
    assert added.code == 0, added.err
    assert "desk (1), whiteboard (1); --synonyms auto joins names of known label sets" in added.err


def test_numbers_read_by_a_maps_labelspace_are_told(semloc, write_corridor, home_map, tmp_path) -> None:
    """16 is a table in one file and a dog in another: only a person can see it."""
    ids = {"chair": (5,), "table": (16,)}
    numbers = without_names(write_corridor(tmp_path / "numbers.json", ["chair", "table", "chair"], ids))
    added = semloc("map", "add", home_map, numbers)
    assert added.code == 0, added.err
    assert "class numbers without names, read as labelspace coco has them: 5 bus, 16 dog" in added.err


def test_numbers_that_are_the_maps_own_classes_are_no_news(semloc, write_corridor, tmp_path) -> None:
    numbers = without_names(write_corridor(tmp_path / "numbers.json", ["chair", "table", "chair"] * 5))
    assert semloc("train", numbers, "--encoder", "histogram", "-o", tmp_path / "a.model").code == 0
    built = semloc("map", "build", numbers, "--model", tmp_path / "a.model", "-o", tmp_path / "a.map")
    assert (built.code, built.err) == (0, "")


def test_no_advice_to_name_classes_that_were_named(semloc, write_corridor, home_map, tmp_path) -> None:
    ids = {"chair": (5,), "lamp": (11,), "table": (16,)}
    classes = ["table", "table", "lamp", "chair"]
    numbers = without_names(write_corridor(tmp_path / "numbers.json", classes, ids))
    named = semloc("map", "build", numbers, "--labelspace", "uhumans2_apartment", "-o", tmp_path / "a.map")
    assert named.code == 0, named.err
    assert "lamp" in semloc("map", "info", tmp_path / "a.map").out
    names = semloc("map", "add", home_map, numbers, "--labelspace", "uhumans2_apartment")
    assert names.code == 2
    assert "table (2), lamp (1)" in names.err, "by the names that were given, not by numbers"
    assert "--labelspace" not in names.err


def test_a_scene_graph_in_place_of_a_labelspace_is_refused_at_once(semloc, write_corridor, tmp_path) -> None:
    """YAML takes a minute to say that a big graph is none."""
    graph = write_corridor(tmp_path / "big.json", ["chair"] * 200)
    assert graph.stat().st_size > 1 << 17
    refused = semloc("map", "build", graph, "--labelspace", graph, "-o", tmp_path / "a.map")
    assert refused.code == 2
    assert "expected a YAML file of a labelspace" in refused.err
    assert "128 kB" in refused.err


def test_a_map_that_refuses_is_a_whole_map(semloc, write_corridor, home_map, tmp_path) -> None:
    good = write_corridor(tmp_path / "good.json", HOME)
    bad = write_corridor(tmp_path / "bad.json", OFFICE)
    assert semloc("map", "add", home_map, good, bad).code == 2
    with sqlite3.connect(home_map) as there:
        assert there.execute("SELECT COUNT(*) FROM building").fetchone() == (1,), "both or none"


def test_numbers_that_nobody_named_are_classes_of_a_map_of_their_own_and_refused_by_another(
    semloc, write_corridor, tmp_path
) -> None:
    home = write_corridor(tmp_path / "home.json", HOME)
    assert semloc("map", "build", home, "-o", tmp_path / "home.map").code == 0
    numbers = without_names(
        write_corridor(tmp_path / "numbers.json", ["chair", "table"], {"chair": (3,), "table": (9,)})
    )
    built = semloc("map", "build", numbers, "-o", tmp_path / "b.map")
    assert built.code == 0, built.err
    assert "class_9" in semloc("map", "info", tmp_path / "b.map").out
    refused = semloc("map", "add", tmp_path / "home.map", numbers)
    assert refused.code == 2
    assert "class_3 (1), class_9 (1); --labelspace says which classes these numbers are" in refused.err
    names = tmp_path / "names.yaml"
    names.write_text("synonyms: {3: chair, 9: couch}")
    added = semloc("map", "add", tmp_path / "home.map", numbers, "--synonyms", names)
    assert (added.code, added.err) == (0, "")


def test_what_a_person_says_of_numbers_wins_over_the_models(semloc, write_corridor, tmp_path) -> None:
    """In COCO's labelspace 3 is a motorcycle."""
    numbers = without_names(write_corridor(tmp_path / "numbers.json", ["a", "b", "a", "b"], {"a": (3,), "b": (5,)}))
    names = tmp_path / "names.yaml"
    names.write_text("synonyms: {class_3: chair, class_5: Dining-Table}")
    built = semloc("map", "build", numbers, "--labelspace", "coco", "--synonyms", names, "-o", tmp_path / "a.map")
    assert built.code == 0, built.err
    told = semloc("map", "info", tmp_path / "a.map").out
    assert "dining table" in told
    assert "motorcycle" not in told
    run = tmp_path / "run.mcap"
    recorded = semloc("bag", "simulate", numbers, "--distance", "6", "--false-rate", "0", "-o", run)
    assert "class numbers without names are recorded as such: class_3 (2), class_5 (2)" in recorded.err
    replayed = semloc("replay", run, "--map", tmp_path / "a.map", "-q")
    assert replayed.code == 0, replayed.err
    assert "read as labelspace coco has them: 3 chair, 5 dining table" in replayed.err
    home = write_corridor(tmp_path / "home.json", HOME)
    assert semloc("map", "build", home, "-o", tmp_path / "home.map").code == 0
    lost = semloc("replay", run, "--map", tmp_path / "home.map", "-q")
    assert "all objects are of classes that the map does not know: class_" in lost.err
    assert "--labelspace says which classes these numbers are" in lost.err


def test_mostly_unknown_is_taken_without_a_model_where_that_is_meant(semloc, write_corridor, tmp_path) -> None:
    office = write_corridor(tmp_path / "office.json", OFFICE)
    assert "--allow-unknown" in semloc("train", office, "--labelspace", "coco", "-o", tmp_path / "a.model").err
    built = semloc("map", "build", office, "--labelspace", "coco", "--allow-unknown", "-o", tmp_path / "a.map")
    assert built.code == 0, built.err
    assert "desk (2), whiteboard (1)" in built.err


@pytest.mark.parametrize(
    "command", ["train", "map build", "map add", "map replace", "map merge", "replay", "explain", "bag simulate"]
)
def test_options_that_are_advised_are_there(semloc, command) -> None:
    told = semloc(*command.split(), "--help").out
    assert "--labelspace" in told
    assert "--synonyms" in told
    if command in ("train", "map build", "map add", "map replace", "map merge"):
        assert "--allow-unknown" in told
