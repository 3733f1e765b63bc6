"""A new building without training, and what training on its own map adds: by the commands alone."""

import contextlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from semloc_core.cli import main
from semloc_core.encoding.model import Model
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.map_database import load
from semloc_core.sources.hydra import read_hydra, write_hydra


@pytest.fixture
def semloc(capsys, monkeypatch):
    """Run the command: exit status, stdout, stderr."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["semloc", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    """A generated home."""
    root, argv = tmp_path_factory.mktemp("town"), sys.argv
    sys.argv = ["semloc", "world", "many", str(root), "--kind", "home", "--count", "1", "--seed", "77"]
    try:
        with contextlib.suppress(SystemExit):
            main()
    finally:
        sys.argv = argv
    return root / "home_77_000" / "map.json"


def test_a_building_is_mapped_without_a_model_and_the_command_says_by_which(semloc, home, tmp_path) -> None:
    code, _, err = semloc("map", "build", home, "-o", tmp_path / "home.map")
    assert code == 0, err
    classes = {thing.class_ for thing in read_hydra(home).graph.objects.values()}
    assert err == "no --model: the general encoder, fitted to 80 classes of the buildings' own\n"
    assert classes <= set(load(tmp_path / "home.map").model.labelspace.classes)
    loaded = load(tmp_path / "home.map")
    assert loaded.model.provenance["general"]
    assert loaded.buildings == ("home_77_000",)


def test_a_building_of_any_names_is_mapped_and_found_again(semloc, home, tmp_path) -> None:
    """Names that nobody has heard of tell places apart as well as those that they stand for."""
    graph = read_hydra(home).graph
    text = home.read_text()
    for class_ in {thing.class_ for thing in graph.objects.values()}:
        text = text.replace(f'"{class_}"', f'"odd {class_}"')
    odd = tmp_path / "odd.json"
    odd.write_text(text)
    code, _, err = semloc("map", "build", odd, "-o", tmp_path / "odd.map")
    assert (code, err.count("\n")) == (0, 1), err
    assert semloc("map", "build", home, "-o", tmp_path / "home.map")[0] == 0
    strange, known = load(tmp_path / "odd.map"), load(tmp_path / "home.map")
    assert all(thing.class_.startswith("odd ") for thing in strange.graph("odd").objects.values())
    alike = [one.embeddings @ one.embeddings.T for one in (strange, known)]
    np.testing.assert_allclose(*alike, atol=1e-3)


def test_numbers_for_classes_are_read_by_the_labelspace_given(semloc, home, tmp_path) -> None:
    """A lamp is number 11 in the apartment."""
    graph, numbers = read_hydra(home).graph, {"chair": 5, "couch": 7, "lamp": 11}
    for thing, class_ in zip(list(graph.objects.values()), ["chair", "couch", "chair", "lamp"] * 99, strict=False):
        graph.objects[thing.id] = type(thing)(thing.id, class_, thing.position, thing.size)
    nameless = tmp_path / "apartment.json"
    write_hydra(nameless, graph, Labelspace("n", tuple(numbers), {name: (n,) for name, n in numbers.items()}))
    document = json.loads(nameless.read_text())
    document["metadata"].pop("labelspaces")
    for node in document["nodes"]:
        node["attributes"]["name"] = ""
    nameless.write_text(json.dumps(document))
    code, _, err = semloc("map", "build", nameless, "-o", tmp_path / "a.map", "--labelspace", "uhumans2_apartment")
    assert code == 0, err
    classes = {thing.class_ for thing in load(tmp_path / "a.map").graph("apartment").objects.values()}
    assert classes == {"chair", "couch", "lamp"}


def test_training_on_the_buildings_own_map_says_by_how_much(semloc, home, tmp_path) -> None:
    few = ("--steps", 4, "--set", "redecorated=0", "--set", "fragment_walks=1", "--set", "pool=2")
    figures = tmp_path / "figures.json"
    code, out, err = semloc("train", home, "--start", "general", "-o", tmp_path / "m", "--json", figures, *few)
    assert code == 0, err
    rows = {(row["method"], row["scope"]): row for row in json.loads(figures.read_text())["rows"]}
    assert set(rows) == {(m, s) for m in ("start", "trained") for s in ("whole", "fragment")}
    for scope in ("whole", "fragment"):
        before, after = (rows[m, scope]["success@1"] for m in ("start", "trained"))
        assert f"{scope}: success@1 {before:.3f} at the start, {after:.3f} trained ({after - before:+.3f})" in out
    assert semloc("map", "build", home, "-o", tmp_path / "home.map")[0] == 0
    assert Model.load(tmp_path / "m").provenance["start"] == load(tmp_path / "home.map").model.hash


def test_training_trains_the_encoder_with_attention_unless_told(semloc, home, tmp_path) -> None:
    few = ("--steps", 2, "--set", "redecorated=0", "--set", "fragment_walks=1", "--set", "encoder.dimension=16")
    assert semloc("train", home, "-o", tmp_path / "m", *few)[0] == 0
    made = Model.load(tmp_path / "m")
    assert (made.encoder.name, made.encoder.dimension) == ("geodesic_attention", 16)
    assert semloc("train", home, "-o", tmp_path / "p", "--encoder", "paper", "--steps", 2)[0] == 0
    assert Model.load(tmp_path / "p").encoder.name == "paper"


@pytest.mark.parametrize(
    "words",
    [
        ("--start", "kitchen"),
        ("--start", "general", "--encoder", "paper"),
        ("--set", "redecorated"),
        ("--set", "redecorate=1"),
        ("--set", "redecorated=-1"),
        ("--set", "encoder.centre=1"),
    ],
)
def test_a_wrong_option_of_training_is_one_line(semloc, home, tmp_path, words) -> None:
    code, _, err = semloc("train", home, "-o", tmp_path / "m", *words)
    assert (code, err.count("\n")) == (2, 1), err
    assert not (tmp_path / "m").exists()
