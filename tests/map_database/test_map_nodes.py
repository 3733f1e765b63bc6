"""Two robots on one map file while a third process changes it: each answers by one committed state or another."""

from __future__ import annotations

import multiprocessing
import shutil
import sys
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
from small_building import building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, MapDatabase, load

ROUNDS = 4
CONFIG = LocaliserConfig(filter="bayes")
UPDATES = [building_update(20, 12), *(delta(seq, query=f"p{seq}") for seq in range(1, 8))]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs fork")


def answers(loaded: LoadedMap) -> list[bytes]:
    """What a robot with this map says to the updates."""
    localiser = Localiser(loaded, CONFIG)
    return [wire.encode(localiser.update(update).matches) for update in UPDATES]


def robot(path: Path, end: Connection) -> None:
    """Load, answer, say what, load again: until it is told to stop; then what the first map loaded still says."""
    first = load(path)
    while not end.poll():
        loaded = load(path)
        end.send((loaded.hash, answers(loaded)))
    end.send((first.hash, answers(first)))
    end.send(None)


def test_two_robots_and_a_writer(tmp_path: Path) -> None:
    model, other = make_model("paper"), building_update(15, 9, seed=3)
    path = tmp_path / "site.map"
    small = make_map(path, model, home=building_update(20, 12))
    copy = tmp_path / "copy" / path.name  # answers name the map
    copy.parent.mkdir()
    shutil.copy(path, copy)
    graph = SceneGraph.from_update(other)
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace, "other")
    building = (graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))

    def change(file: Path, add: bool) -> None:
        with MapDatabase.open(file) as database:
            if add:
                database.add_building("other", *building)
            else:
                database.remove_building("other")

    change(copy, add=True)
    large = load(copy)
    expected = {loaded.hash: answers(loaded) for loaded in (small, large)}
    assert len({answer[0] for answer in expected.values()}) == 2

    context = multiprocessing.get_context("fork")
    robots = []
    for _ in range(2):
        ours, theirs = context.Pipe()
        process = context.Process(target=robot, args=(path, theirs))
        process.start()
        theirs.close()
        robots.append((process, ours))
    found = []
    for n in range(2 * ROUNDS):
        change(path, add=n % 2 == 0)
        found += [ours.recv() for _, ours in robots]  # so that both keep up, however busy the machine
    for process, ours in robots:
        ours.send("stop")
        while (said := ours.recv()) is not None:
            found.append(said)
        process.join()
        assert process.exitcode == 0
    assert all(said == expected[state] for state, said in found)
    assert {state for state, _ in found} == set(expected), "the robots never saw a change"
    assert load(path).hash == small.hash
    assert {each.name for each in tmp_path.iterdir()} == {"site.map", "copy"}
