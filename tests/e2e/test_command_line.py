"""The command line from a graph file to an explained answer, and what it says to bad input: one line, exit 2."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from semloc_core.cli import main
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources.hydra import write_hydra
from semloc_core.sources.world import OfficeConfig, make_office, write_world


class Result:
    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


def call(words: tuple[object, ...]) -> int:
    """Run the command in this process; its exit status."""
    before, sys.argv = sys.argv, ["semloc", *map(str, words)]
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    finally:
        sys.argv = before
    return 0


@pytest.fixture
def semloc(capsys):
    """Run the command and keep what it says."""

    def run(*words: object) -> Result:
        code = call(words)
        captured = capsys.readouterr()
        return Result(code, captured.out, captured.err)

    return run


@pytest.fixture(scope="module")
def house(tmp_path_factory) -> Path:
    """An office, an encoder with nothing to train, a map and a run: made once, by the commands themselves."""
    folder = tmp_path_factory.mktemp("house")
    write_world(folder / "office.json", make_office(OfficeConfig(), np.random.default_rng(1)))
    for words in (
        ("train", folder / "office.json", "-o", folder / "office.model", "--encoder", "rings"),
        ("map", "build", folder / "office.json", "--model", folder / "office.model", "-o", folder / "office.map"),
        ("bag", "simulate", folder / "office.json", "-o", folder / "run.mcap", "--distance", 12, "--rate", 1),
    ):
        assert call(words) == 0, words
    return folder


@pytest.fixture
def office(house) -> Path:
    return house / "office.json"


@pytest.fixture
def model(house) -> Path:
    return house / "office.model"


@pytest.fixture
def map_file(house, tmp_path) -> Path:
    """A copy, since some tests change it."""
    return Path(shutil.copy(house / "office.map", tmp_path / "office.map"))


@pytest.fixture
def run(house) -> Path:
    return house / "run.mcap"


def test_from_graph_to_explained_answer(semloc, office, map_file, run, tmp_path):
    results = tmp_path / "results.mcap"
    replayed = semloc("replay", run, "--map", map_file, "-o", results, "--json", tmp_path / "figures.json")
    assert replayed.code == 0, replayed.err
    assert "because" in replayed.out
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["command"] == "replay"
    assert {"0m", "5m", "all"} <= {row["scope"] for row in figures["rows"]}
    whole = figures["rows"][-1]
    assert whole["scope"] == "all"
    assert 0 <= whole["success@1"] <= whole["success@5"] <= whole["success@10"] <= 1
    assert f"{whole['success@1']:.3f}" in replayed.out, "the table on screen must be the figures"
    assert results.stat().st_size > 0

    place = min(json.loads(office.read_text())["nodes"], key=lambda n: (n["layer"] != 3, n["id"]))["id"]
    explained = semloc("explain", map_file, office, "--query", place)
    assert explained.code == 0, explained.err
    assert f"asked: place p{place & (1 << 56) - 1} " in explained.out
    assert semloc("explain", map_file, office, "--query", f"p({place & (1 << 56) - 1})").out == explained.out
    answered = semloc("explain", map_file, office, "--query", place, "--methods", "layout")
    assert re.search(r"^UNLESS   .*probability", answered.out, re.MULTILINE)
    for words in (("--place-near", "3,4"), ("--place", "p7")):
        elsewhere = semloc("explain", map_file, office, "--query", place, "--methods", "layout", *words)
        assert elsewhere.code == 0, elsewhere.err
        assert re.search(
            r"WHY NOT  office, place p\d+ at \(.*\), \d+\.\d m from the answer, probability [01]\.\d{3}: "
            r"-?\d+\.\d nats, against \d+\.\d of ",
            elsewhere.out,
        )
        assert elsewhere.out.startswith(answered.out), "all that is said of the answer, and why not there"
    assert semloc("explain", map_file, office, "--query", place, "--rival", 99).code == 2
    assert "number 2" not in explained.out
    assert "rank" in semloc("explain", map_file, office, "--query", place, "--long").out


def test_a_place_is_asked_about_by_id_by_point_or_as_where_the_run_ends(semloc, office, map_file, run):
    by_point = semloc("explain", map_file, office, "--near", "3,4", "--methods", "attention")
    assert by_point.code == 0, by_point.err
    place = by_point.out.split("asked: place ")[1].split()[0]
    assert re.search(r", \d+\.\d\d m from 3,4$", by_point.out, re.MULTILINE), by_point.out
    by_id = semloc("explain", map_file, office, "--query", place, "--methods", "attention")
    assert re.sub(r", .{4,6} m from 3,4", "", by_point.out) == by_id.out
    assert semloc("explain", map_file, run, "--methods", "attention").code == 0
    for words in (
        (),
        ("--near", "here"),
        ("--near", "1"),
        ("--near", "nan,0"),
        ("--near", "1,2", "--query", place),
        ("--near", "-300,4"),
    ):
        assert semloc("explain", map_file, office, *words).code == 2, words


def test_a_run_of_another_frame_is_said_to_be_scored_as_this_building(semloc, house, map_file, tmp_path):
    """A run through another building would else pass for a bad score in this one."""
    other = shutil.copy(house / "office.json", tmp_path / "elsewhere.json")
    assert semloc("bag", "simulate", other, "-o", tmp_path / "r.mcap", "--distance", 3, "--rate", 1).code == 0
    assert (
        "frame elsewhere; scored as if that were building office"
        in semloc("replay", tmp_path / "r.mcap", "--map", map_file, "-q").err
    )


def test_a_run_in_a_building_that_is_left_out_is_not_scored_against_another(semloc, house, model, tmp_path):
    for name in ("hq_1", "hq_2"):
        shutil.copy(house / "office.json", tmp_path / f"{name}.json")
    graphs, map_ = [tmp_path / "hq_1.json", tmp_path / "hq_2.json"], tmp_path / "hq.map"
    assert semloc("map", "build", *graphs, "--model", model, "-o", map_).code == 0
    assert semloc("bag", "simulate", graphs[0], "-o", tmp_path / "r.mcap", "--distance", 3, "--rate", 1).code == 0
    figures = tmp_path / "figures.json"
    ran = semloc("replay", tmp_path / "r.mcap", "--map", map_, "-q", "--buildings", "hq_2", "--json", figures)
    assert "in hq_1, which --buildings leaves out: every answer there is wrong" in ran.err
    assert "scored as if" not in ran.err
    assert json.loads(figures.read_text())["rows"][-1]["success@10"] == 0
    assert semloc("map", "remove", map_, "hq_1", "hq_2").code == 0
    assert "answers not scored: the map has no buildings" in semloc("replay", tmp_path / "r.mcap", "--map", map_).err


@pytest.mark.parametrize("filter_", ["none", "bayes"])
def test_a_replay_gives_the_same_bytes_again(filter_, semloc, map_file, run, tmp_path):
    for name in ("a.mcap", "b.mcap"):
        assert semloc("replay", run, "--map", map_file, "-o", tmp_path / name, "-q", "--filter", filter_).code == 0
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_map_is_built_from_a_run_too(semloc, model, run, tmp_path):
    built = semloc("map", "build", run, "--model", model, "-o", tmp_path / "run.map")
    assert built.code == 0, built.err
    assert "places in 1 building" in built.out


def test_buildings_are_added_replaced_and_removed(semloc, office, map_file, run):
    assert semloc("map", "add", map_file, run, "--name", "annex").code == 0
    assert "annex" in semloc("map", "info", map_file).out
    assert semloc("map", "add", map_file, run, "--name", "annex").code == 2
    assert semloc("map", "replace", map_file, office, "--name", "annex").code == 0
    assert semloc("map", "remove", map_file, "annex").code == 0
    assert "annex" not in semloc("map", "info", map_file).out
    assert semloc("map", "remove", map_file, "annex").code == 2


def test_an_existing_map_is_not_overwritten_unless_told(semloc, office, model, map_file):
    before = map_file.read_bytes()
    again = semloc("map", "build", office, "--model", model, "-o", map_file)
    assert again.code == 2
    assert map_file.read_bytes() == before
    assert semloc("map", "build", office, "--model", model, "-o", map_file, "--force").code == 0


def test_a_failed_build_leaves_what_was_there(semloc, office, model, map_file, tmp_path):
    before = semloc("map", "info", map_file).out
    bad = tmp_path / "bad.json"
    bad.write_text("{")
    assert semloc("map", "build", office, bad, "--model", model, "-o", map_file, "--force").code == 2
    assert semloc("map", "info", map_file).out == before
    assert semloc("map", "build", office, bad, "--model", model, "-o", tmp_path / "new.map").code == 2
    assert not list(tmp_path.glob("*new.map*"))


def _empty_graph(path: Path, places: int) -> None:
    from semloc_core.wire import Place, SceneGraphUpdate

    update = SceneGraphUpdate(
        schema="semloc/scene_graph_update/1", stamp_ns=0, frame_id="map", seq=0, full=True, objects=[], edges=[],
        places=[Place(id=str(ord("p") << 56 | i), position=(0.0, 0.0, 0.0)) for i in range(places)], query_place=None,
    )  # fmt: skip
    write_hydra(path, SceneGraph.from_update(update), Labelspace("none", ("chair",)))


BAD_FILES = {
    "truncated.json": b'{"nodes": [{"id": 8070450532247928832, "lay',
    "other.json": b'{"hello": "world"}',
    "list.json": b"[]",
    "empty.json": b"",
    "binary.json": bytes(range(256)) * 16,
    "nan.json": b'{"nodes": [{"id": 1, "layer": 3, "attributes": {"type": "PlaceNodeAttributes", '
    b'"position": [NaN, 0, 0]}}], "edges": [], "layer_ids": [3]}',
    "corrupt.mcap": b"\x89MCAP0\r\n" + b"\xff" * 400,
    "no_bag.mcap": b"rosbag",
    "corrupt.map": b"SQLite format 3\x00" + b"\x00\xff" * 3000,
    "no_map.map": b"nothing",
    "corrupt.model": b"PK\x03\x04" + b"\x00" * 100,
}


@pytest.fixture
def bad(tmp_path):
    def make(name: str) -> Path:
        path = tmp_path / name
        if name == "no_places.json":
            _empty_graph(path, 0)
        elif name == "one_place.json":
            _empty_graph(path, 1)
        elif name == "no_objects.json":
            _empty_graph(path, 5)
        elif name in BAD_FILES:
            path.write_bytes(BAD_FILES[name])
        return path

    return make


GRAPHS = [n for n in BAD_FILES if n.endswith(".json")] + ["no_places.json", "one_place.json", "no_objects.json"]


@pytest.mark.parametrize(
    ("command", "name"),
    [(command, name) for command in ("train", "build") for name in [*GRAPHS, "missing.json"]]
    + [(command, name) for command in ("replay", "build") for name in ("corrupt.mcap", "no_bag.mcap", "missing.mcap")]
    + [(command, name) for command in ("map", "info") for name in ("corrupt.map", "no_map.map", "missing.map")]
    + [("model", name) for name in ("corrupt.model", "no_map.map", "missing.model")]
    + [("office", name) for name in (*GRAPHS, "missing.json")]
    + [("simulate", name) for name in ("truncated.json", "no_places.json", "missing.json")]
    + [("labelspace", name) for name in ("list.json", "missing.yaml", "binary.json")],
)
def test_bad_input_is_one_line_and_exit_2(semloc, bad, office, model, map_file, run, tmp_path, command, name):
    path, new = bad(name), tmp_path / "new"
    words = {
        "train": ("train", path, "-o", new),
        "build": ("map", "build", path, "--model", model, "-o", new),
        "replay": ("replay", path, "--map", map_file),
        "map": ("replay", run, "--map", path),
        "info": ("map", "info", path),
        "model": ("map", "build", office, "--model", path, "-o", new),
        "office": ("evaluate", "office", path, "--seeds", 1),
        "simulate": ("bag", "simulate", path, "-o", new),
        "labelspace": ("train", office, "-o", new, "--labelspace", path),
    }[command]
    result = semloc(*words)
    if (command, name) in {("build", "one_place.json"), ("build", "no_objects.json")}:
        assert result.code == 0, "a building with little in it is still a building"
        return
    assert result.code == 2, (result.out, result.err)
    errors = [line for line in result.err.splitlines() if not line.startswith("WARNING")]
    assert len(errors) == 1, result.err
    assert errors[0].startswith("semloc: ")
    assert "Traceback" not in result.err
    assert not new.exists()


@pytest.mark.parametrize(
    "words",
    [
        ("replay", "{run}", "--map", "{map}", "--top-n", "0"),
        ("replay", "{run}", "--map", "{map}", "--accept-probability", "2"),
        ("replay", "{run}", "--map", "{map}", "--topic", "/other"),
        ("explain", "{map}", "{office}", "--query", "nowhere"),
        ("bag", "simulate", "{office}", "-o", "{new}", "--speed", "-1"),
        ("bag", "simulate", "{office}", "-o", "{new}", "--distance", "0"),
        ("train", "{office}", "-o", "{new}", "--encoder", "oracle"),
        ("train", "{office}", "-o", "{new}", "--labelspace", "nowhere"),
        ("map", "build", "{office}", "{office}", "--model", "{model}", "-o", "{new}"),
        ("evaluate", "relocalise", "{folder}"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(semloc, office, model, map_file, run, tmp_path, words):
    names = {
        "run": run, "map": map_file, "office": office, "model": model, "new": tmp_path / "new", "folder": tmp_path
    }  # fmt: skip
    result = semloc(*(word.format(**names) for word in words))
    assert result.code == 2, (result.out, result.err)
    assert len([line for line in result.err.splitlines() if not line.startswith("WARNING")]) == 1, result.err


def test_a_graph_of_other_classes_is_reported_class_by_class(semloc, office, map_file, tmp_path):
    document = json.loads(office.read_text())
    for pair in document["metadata"]["labelspaces"]["_l2p0"]:
        pair[1] = pair[1].replace("couch", "sofa")
    for node in document["nodes"]:
        if node["attributes"].get("name") == "couch":
            node["attributes"]["name"] = "sofa"
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document))
    added = semloc("map", "add", map_file, other, "--name", "other")
    assert added.code == 0, added.err
    assert "sofa (11)" in added.err


def test_a_synonym_file_joins_a_detectors_names_to_the_maps(semloc, house, model, run, tmp_path):
    """Else a map made with one detector is useless with another."""
    text = (house / "office.json").read_text()
    other = tmp_path / "other.json"
    other.write_text(text.replace('"couch"', '"love seat"'))
    synonyms = tmp_path / "synonyms.yaml"
    synonyms.write_text("synonyms: {love seat: couch}\n")
    assert "love seat (11)" in semloc("map", "build", other, "--model", model, "-o", tmp_path / "a.map").err
    joined = semloc("map", "build", other, "--model", model, "-o", tmp_path / "b.map", "--synonyms", synonyms)
    assert joined.code == 0, joined.err
    assert "love seat" not in joined.err
    walked = semloc("bag", "simulate", other, "-o", tmp_path / "other.mcap", "--distance", 5, "--rate", 1)
    assert walked.code == 0
    alone = semloc("replay", tmp_path / "other.mcap", "--map", house / "office.map", "-q")
    assert "love seat" in alone.err
    told = semloc("replay", tmp_path / "other.mcap", "--map", house / "office.map", "-q", "--synonyms", synonyms)
    assert "love seat" not in told.err
    by_map = semloc("replay", tmp_path / "other.mcap", "--map", tmp_path / "b.map", "-q")
    assert "love seat" not in by_map.err
    synonyms.write_text("synonyms: {love seat: zeppelin}\n")
    assert semloc("replay", run, "--map", house / "office.map", "--synonyms", synonyms).code == 2


def test_help_teaches_the_whole_way(semloc):
    text = semloc("--help").out
    steps = ("semloc world", "semloc map build", "semloc bag simulate", "semloc replay", "semloc view")
    at = [text.find(step) for step in steps]
    assert -1 not in at
    assert at == sorted(at), "a first day's commands, in order"
