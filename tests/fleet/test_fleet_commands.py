"""``semloc map`` on a server: whatever is done to a map there leaves what the same does to a file."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from semloc_core.cli import main
from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.creating import make_collections
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.map_database import load
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
    """Two offices and a model."""
    folder = tmp_path_factory.mktemp("house")
    for seed, name in enumerate(("office", "other")):
        world = make_office(OFFICE, np.random.default_rng(seed))
        write_world(folder / f"{name}.json", world)
    Model(build_encoder("rings", None, len(world.labelspace)), world.labelspace).save(folder / "rings.model")
    return folder


def test_the_same_as_of_a_file(semloc, house: Path, tmp_path: Path, address: MilvusAddress) -> None:
    """Built, added to, merged into (which embeds all buildings anew), edited, narrowed and copied to and fro."""
    run = ("bag", "simulate", house / "office.json", "-o", house / "again.mcap", "--distance", "60")
    assert semloc(*run).code == 0
    file = tmp_path / "site.map"
    source = MilvusSource(address, poll_s=0.0)
    steps = [
        ("build", house / "office.json", "--model", house / "rings.model", "-o"),
        ("add", house / "other.json"),
        ("merge", house / "again.mcap", "--building", "office"),
        ("add", house / "office.json", "--name", "site 'b'/\"ü\""),
        ("replace", house / "other.json"),
        ("remove", "site 'b'/\"ü\""),
    ]
    for verb, *words in steps:
        said = []
        for place in (file, address):
            parts = ("map", verb, *words, place) if words[-1] == "-o" else ("map", verb, place, *words)
            ran = semloc(*parts)
            assert ran.code == 0, ran.err
            said.append(ran.out.replace(str(place), "PLACE"))
        assert said[0] == said[1]
        assert source.catalogue().content_hash == load(file).hash, verb
    assert source.catalogue().buildings["office"].changes, "the merge taught nothing of classes"

    there, here = semloc("map", "info", address).out.splitlines(), semloc("map", "info", file).out.splitlines()
    assert there[1:] == here[1:]
    assert there[0] == here[0].replace("site", address.name)
    before = load(file).hash
    for place in (file, address):
        again = ("map", "merge", place, house / "again.mcap", "--dry-run")
        assert semloc(*again).code == 2, "it was merged before"
        assert semloc(*again, "--force").code == 0
    assert source.catalogue().content_hash == load(file).hash == before

    pulled = tmp_path / "pulled.map"
    assert before in semloc("map", "pull", address, pulled).out
    assert load(pulled).hash == before
    assert "--force" in semloc("map", "pull", address, pulled).err
    second = MilvusAddress(address.host, address.port, f"{address.name[:60]}_2")
    pushed = semloc("map", "push", pulled, second).out
    assert f"2 buildings written, 0 were there already; 2 in all, hash {before}" in pushed
    assert "0 buildings written, 2 were there already" in semloc("map", "push", pulled, second).out
    # A part of the map knows less of what moves: it is embedded anew, as if merged on its own.
    assert semloc("map", "pull", address, tmp_path / "part.map", "--buildings", "oth*").code == 0
    assert load(tmp_path / "part.map").buildings == ("other",)
    build = ("map", "build", house / "other.json", "--model", house / "rings.model", "-o")
    assert semloc(*build, tmp_path / "own.map").code == 0
    assert load(tmp_path / "part.map").hash == load(tmp_path / "own.map").hash
    assert semloc("map", "push", pulled, second, "--buildings", "nowhere*").code == 2
    assert semloc("map", "sweep", address).out.endswith("0 left-over generations deleted\n")
    assert semloc(*build, second, "--force").code == 0
    assert MilvusSource(second).catalogue().content_hash == load(tmp_path / "own.map").hash
    source.close()


def test_an_address_where_a_file_must_be(semloc, tmp_path: Path) -> None:
    for address in ("milvus+http://h:1/site", "http://h:1/site", "milvus+http://me:hush@h/site"):
        for words in (
            ("explain", address, tmp_path / "graph.json"),
            ("report", "replay", tmp_path / "r.mcap", "--map", address, "-o", tmp_path / "r.html"),
            ("map", "push", address, "milvus+http://h:1/other"),
        ):
            ran = semloc(*words)
            said = "" if "@" in address else f": {address}"
            wanted = f"expected a map file (got an address; semloc map pull makes a file of it{said})"
            assert (ran.code, ran.err) == (2, f"semloc: {wanted}\n")


def test_a_first_push_that_was_killed_and_an_index_that_comes_too_late(
    semloc, house: Path, tmp_path: Path, address: MilvusAddress
) -> None:
    file = tmp_path / "x.map"
    build = ("map", "build", house / "office.json", "--model", house / "rings.model", "-o", file)
    assert "expected --index with a map on a server" in semloc(*build, "--index", "FLAT").err
    assert not file.exists()
    assert semloc(*build).code == 0
    server = Server(address)
    make_collections(server, load(file).model, "FLAT")  # as far as a writer comes that is killed at its first step
    server.close()
    assert "begun and never finished: push or build it again" in semloc("map", "info", address).err
    assert "no effect" not in semloc("map", "push", file, address, "--index", "FLAT").err
    again = semloc("map", "push", file, address, "--index", "FLAT")
    assert again.code == 0
    assert f"--index FLAT has no effect: {address} was made before" in again.err


def test_one_line_where_it_can_not_be(semloc, house: Path, tmp_path: Path, address: MilvusAddress) -> None:
    build = ("map", "build", house / "office.json", "--model", house / "rings.model", "-o")
    assert semloc(*build, address).code == 0
    assert semloc(*build, tmp_path / "x.map").code == 0
    other = ("map", "build", house / "office.json", "-o", tmp_path / "other.map")
    assert semloc(*other).code == 0
    nobody = f"milvus+http://127.0.0.1:1/{address.name}"
    for words, message in (
        ((*build, address), r"a new map, or --force .* 1 buildings"),
        (("map", "add", address, house / "office.json"), "a building that the map does not have"),
        (("map", "remove", address, "nowhere"), r"one of the map's buildings: office \(got 'nowhere'\)"),
        (("map", "replace", address, house / "other.json"), r"one of the map's buildings: office \(got 'other'\)"),
        (("map", "info", f"{address}x"), f"a map '{address.name}x' at http://127.0.0.1"),
        (("map", "push", tmp_path / "other.map", address), f"map '{address.name}' made with model"),
        (("map", "push", tmp_path / "x.map", f"{address}y", "--index", "MAGIC"), "an index of HNSW, FLAT"),
        (("map", "push", tmp_path / "x.map", "x.map"), "an address milvus"),
        (("map", "sweep", tmp_path / "x.map"), "an address milvus"),
        (("map", "add", nobody, house / "office.json"), "got none: no server there"),
        ((*build, nobody), "got none: no server there"),
        (("map", "pull", "milvus+http://me:hush@h/x", tmp_path / "y.map"), "without user or token"),
    ):
        ran = semloc(*words)
        assert ran.code == 2, ran
        assert re.fullmatch(rf"semloc: expected [^\n]*{message}[^\n]*\n", ran.err), ran.err
        assert "hush" not in ran.err
    assert not (tmp_path / "y.map").exists()
