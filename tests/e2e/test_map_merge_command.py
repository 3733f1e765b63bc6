"""``semloc map merge`` and single places by hand; and that nothing else ever writes to a map."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from semloc_core.cli import main
from semloc_core.encoding.model import Model
from semloc_core.map_database import load
from semloc_core.sources.hydra.write import write_hydra
from semloc_core.sources.world import OfficeConfig, make_office, write_world

OFFICE = OfficeConfig(darts_per_m2=8.0, spacing_m=(0.7, 1.0), max_edge_m=2.2)


class Ran(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def semloc(capsys, monkeypatch):
    """Run a command line in this process."""

    def run(*words: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["semloc", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        out, err = capsys.readouterr()
        return Ran(code, out, err)

    return run


@pytest.fixture(scope="module")
def house(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("house")
    for seed, name in enumerate(("office", "other")):
        write_world(folder / f"{name}.json", make_office(OFFICE, np.random.default_rng(seed)))
    return folder


@pytest.fixture
def map_file(semloc, house, tmp_path) -> Path:
    if not (house / "office.map").exists():
        made = ("train", house / "office.json", "-o", house / "office.model", "--encoder", "rings")
        assert semloc(*made).code == 0
        built = ("map", "build", house / "office.json", "--model", house / "office.model", "-o", house / "office.map")
        assert semloc(*built).code == 0
        run = ("bag", "simulate", house / "office.json", "-o", house / "run.mcap", "--distance", "60")
        assert semloc(*run).code == 0
    return Path(shutil.copy(house / "office.map", tmp_path / "office.map"))


def test_a_run_merges_into_the_building_that_it_fits(semloc, house, map_file, tmp_path):
    assert semloc("map", "add", map_file, house / "other.json").code == 0
    before = map_file.read_bytes()
    tried = semloc("map", "merge", map_file, house / "run.mcap", "--dry-run")
    assert tried.code == 0, tried.err
    assert "would be confirmed" in tried.out
    assert map_file.read_bytes() == before
    done = semloc("map", "merge", map_file, house / "run.mcap", "--json", tmp_path / "figures.json")
    assert done.code == 0, done.err
    assert done.out.startswith("office: laid on it by")
    (row,) = json.loads((tmp_path / "figures.json").read_text())["rows"]
    assert row["scope"] == "office"
    assert row["confirmed"] >= row["agreeing"] - 2 > 3
    merged = load(map_file)
    assert merged.history("office").traversals[0].source == "run.mcap"
    assert not merged.history("other").traversals
    assert "1 traversal merged; no class is seen to move" in semloc("map", "info", map_file, "--no-aliasing").out


@pytest.mark.parametrize("name", ["[/hq]", "[red]floor[/red] 2", ":smile: x"])
def test_names_are_printed_as_they_are_whatever_a_screen_would_read_in_them(semloc, house, map_file, tmp_path, name):
    odd = tmp_path / "odd.map"
    made = ("map", "build", house / "office.json", "--model", house / "office.model", "--name", name, "-o", odd)
    assert semloc(*made).code == 0
    tried = semloc("map", "merge", odd, house / "run.mcap", "--dry-run")
    assert tried.code == 0, tried.err
    assert tried.out.startswith(f"{name}: laid on it by")
    replayed = semloc("replay", house / "run.mcap", "--map", odd)
    assert replayed.code == 0, replayed.err
    assert f"  {name} (" in replayed.out


def test_another_buildings_traversal_is_refused_in_one_line(semloc, house, map_file):
    before = map_file.read_bytes()
    refused = semloc("map", "merge", map_file, house / "other.json", "--building", "office")
    assert refused.code == 2
    assert refused.err.count("\n") == 1
    assert "building 'office'" in refused.err
    assert semloc("map", "merge", map_file, house / "run.mcap", "--building", "nowhere").code == 2
    assert load(map_file).hash == load(house / "office.map").hash
    assert len(before) > 0


def test_localising_never_changes_a_map(semloc, house, map_file):
    """Only ``semloc map`` writes: a robot that looks about does not rewrite what it is told."""
    assert semloc("map", "merge", map_file, house / "run.mcap").code == 0
    before, when = map_file.read_bytes(), map_file.stat().st_mtime_ns
    replayed = semloc("replay", house / "run.mcap", "--map", map_file, "-o", map_file.parent / "r.mcap", "-q")
    assert replayed.code == 0, replayed.err
    place = load(map_file).place_ids[0]
    assert semloc("explain", map_file, house / "office.json", "--query", place, "--methods", "class_shapley").code == 0
    assert semloc("map", "info", map_file).code == 0
    assert (map_file.read_bytes(), map_file.stat().st_mtime_ns) == (before, when)
    assert sorted(p.name for p in map_file.parent.glob("office.map*")) == ["office.map"]


def test_a_query_is_weighed_as_the_map_is(semloc, house, map_file):
    """Else an identical place would not be the most similar one any more."""
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import MapDatabase
    from semloc_core.map_database.history import ClassChange, History, ObjectBelief, Traversal
    from semloc_core.map_merge.store import write

    model = Model.load(house / "office.model")
    with MapDatabase.open(map_file) as database:
        graph = database.graph("office")
        run = Traversal("x", 0.0, (0.0, 0.0, 0.0), 0.1, 1, 0, 0, 0, 0, 0)
        beliefs = dict.fromkeys(graph.objects, ObjectBelief(1.0, 2, 2))
        write(database, model, "office", graph, History((run,), beliefs, {"chair": ClassChange(10, 90)}))
    loaded = load(map_file)
    place = loaded.place_ids[len(loaded.place_ids) // 2]
    localiser = Localiser(loaded)
    located = localiser.update(graph.to_update(seq=0, stamp_ns=1, frame_id="map", query_place=place))
    assert located.matches is not None
    best = (located.matches.raw_matches or located.matches.matches)[0]  # as the search has it
    assert best.similarity == pytest.approx(1.0, abs=1e-5)
    unweighed = Localiser(load(house / "office.map"))
    unweighed.update(graph.to_update(seq=0, stamp_ns=1, frame_id="map", query_place=place))
    z = unweighed.locate().query.encoded.embedding[0].numpy()
    assert float(z @ loaded.embeddings[loaded.row("office", place)]) < 0.9999


def test_single_places_are_removed_added_and_replaced(semloc, house, map_file, tmp_path):
    before = load(map_file)
    gone = [before.place_ids[i] for i in (3, 50)]
    words = [word for place in gone for word in ("--place", place)]
    assert semloc("map", "remove", map_file, "office", *words).code == 0
    less = load(map_file)
    assert set(before.place_ids) - set(less.place_ids) == set(gone)
    assert gone[0] not in less.graph("office").places
    assert not np.array_equal(less.embeddings[0], before.embeddings[0]) or less.hash != before.hash
    assert semloc("map", "remove", map_file, "office", *words).code == 2
    assert semloc("map", "replace", map_file, house / "office.json", *words).code == 2
    assert semloc("map", "add", map_file, house / "office.json", *words).code == 0
    again = load(map_file)
    assert again.hash == before.hash, "what was taken out and put back is as it was"
    assert semloc("map", "add", map_file, house / "office.json", *words).code == 2

    world = make_office(OFFICE, np.random.default_rng(0))
    graph = world.graph
    x, y, z = graph.places[gone[0]]
    update = graph.to_update(seq=0, stamp_ns=0, frame_id="map")
    for number, place in enumerate(update.places):
        if place.id == gone[0]:
            update.places[number] = type(place)(place.id, (x + 0.25, y, z))
    graph.apply(update)
    write_hydra(tmp_path / "office.json", graph, world.labelspace, world.rooms)
    assert semloc("map", "replace", map_file, tmp_path / "office.json", *words).code == 0
    moved = load(map_file)
    np.testing.assert_allclose(moved.positions[moved.row("office", gone[0])], (x + 0.25, y, z), atol=1e-6)
    assert moved.graph("office").neighbours[gone[1]] == before.graph("office").neighbours[gone[1]]


def test_what_a_removed_building_taught_of_classes_goes_with_it(semloc, house, map_file):
    assert semloc("map", "add", map_file, house / "other.json").code == 0
    plain = load(map_file)
    assert semloc("map", "merge", map_file, house / "run.mcap").code == 0
    merged = load(map_file)
    rows = merged.rows_of("other")
    assert not np.array_equal(merged.embeddings[rows], plain.embeddings[rows]), (
        "classes weigh the same in all buildings"
    )
    assert semloc("map", "remove", map_file, "office").code == 0
    np.testing.assert_array_equal(load(map_file).embeddings, plain.embeddings[rows])


def test_a_merge_is_taken_back_by_one_step_and_the_same_run_known_again(semloc, house, map_file, tmp_path):
    assert semloc("map", "add", map_file, house / "other.json").code == 0
    assert "got none" in semloc("map", "merge", map_file, "--undo").err
    before = load(map_file)
    assert semloc("map", "merge", map_file, house / "run.mcap").code == 0
    once = load(map_file)
    shutil.copy(house / "run.mcap", tmp_path / "renamed.mcap")
    for words in (("--dry-run",), ("--building", "office"), ()):
        again = semloc("map", "merge", map_file, tmp_path / "renamed.mcap", *words)
        assert (again.code, again.err.count("\n")) == (2, 1), again
        assert "merged before as number 1 of 1, run.mcap" in again.err
    assert load(map_file).hash == once.hash
    assert semloc("map", "merge", map_file, tmp_path / "renamed.mcap", "--force").code == 0
    assert len(load(map_file).history("office").traversals) == 2
    back = semloc("map", "merge", map_file, "--undo")
    assert (back.code, back.out) == (0, "office: as before renamed.mcap was merged\n")
    assert load(map_file).history("office").traversals == once.history("office").traversals
    np.testing.assert_array_equal(load(map_file).embeddings, once.embeddings)
    assert "got none" in semloc("map", "merge", map_file, "--undo").err, "one step"
    assert semloc("map", "merge", map_file, house / "run.mcap", "--undo").code == 2
    assert before.hash != load(map_file).hash


def test_the_first_merge_taken_back_leaves_the_map_that_was_built(semloc, house, map_file):
    before = load(map_file)
    assert semloc("map", "merge", map_file, house / "run.mcap").code == 0
    assert semloc("map", "merge", map_file, "--undo", "--building", "office").code == 0
    after = load(map_file)
    assert after.hash == before.hash
    np.testing.assert_array_equal(after.embeddings, before.embeddings)


def test_what_is_edited_after_a_merge_is_not_taken_back_with_it(semloc, house, map_file):
    assert semloc("map", "merge", map_file, house / "run.mcap").code == 0
    merged = load(map_file)
    assert semloc("map", "remove", map_file, "office", "--place", merged.place_ids[3]).code == 0
    edited = load(map_file).hash
    said = semloc("map", "merge", map_file, "--undo")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "it was changed since" in said.err
    assert load(map_file).hash == edited


def test_the_graph_that_a_map_was_built_from_is_no_later_traversal(semloc, house, map_file):
    said = semloc("map", "merge", map_file, house / "office.json")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "(got office.json, that it was mapped from)" in said.err
    assert load(map_file).hash == load(house / "office.map").hash
