"""SIGKILL while a replay writes its results: what is in the bag up to its last chunk is what a whole replay writes."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from killing import Work, calls_of, run_and_kill
from small_building import building_update, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_database import LoadedMap
from semloc_core.replay import recorded as replaying
from semloc_core.sources import write_run
from semloc_core.sources.bag import BagWriter, read_messages
from semloc_core.sources.simulate.traversal import SimulationConfig, simulate_traversal

ROUNDS = int(os.environ.get("SEMLOC_SOAK", "0")) or 6  # set by `make soak`
CONFIG = LocaliserConfig(explain_rate_hz=2.0)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL and fork")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LoadedMap]:
    """A run through a small building, and its map."""
    import numpy as np

    folder = tmp_path_factory.mktemp("killed")
    loaded = make_map(folder / "home.map", make_model("paper"), home=building_update(40, 25))
    graph = SceneGraph.from_update(building_update(40, 25))
    steps = simulate_traversal(graph, SimulationConfig(distance_m=30.0), np.random.default_rng(0))
    write_run(folder / "run.mcap", steps)
    return folder / "run.mcap", loaded


def test_killed_while_replaying(case: tuple[Path, LoadedMap], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, loaded = case
    # Small chunks, so that a short run makes many; users' are of `CHUNK_BYTES`.
    monkeypatch.setattr(replaying, "BagWriter", partial(BagWriter, chunk_bytes=4096))
    replaying.replay(run, loaded, CONFIG, results=tmp_path / "whole.mcap")

    def replayed(path: Path) -> Callable[[Work], None]:
        def work(given: Work) -> None:
            given.begun()
            replaying.replay(run, loaded, CONFIG, results=path)

        return work

    usual = calls_of(replayed(tmp_path / "counted.mcap"))
    whole = [(m.topic, m.stamp_ns, m.data) for m in read_messages(tmp_path / "whole.mcap")]
    rng, found = random.Random(0), []
    for n in range(ROUNDS):
        path = tmp_path / f"{n}.mcap"
        run_and_kill(replayed(path), rng.randint(0, usual), just_there=n % 3 > 0)
        if not path.exists() or path.stat().st_size == 0:  # killed before the first byte
            found.append(0)
            continue
        answers = [(m.topic, m.stamp_ns, m.data) for m in read_messages(path)]
        assert answers == whole[: len(answers)]
        lost = len(whole) - len(answers)
        assert lost == 0 or path.stat().st_size < (tmp_path / "whole.mcap").stat().st_size
        found.append(len(answers))
        path.unlink()
    assert any(0 < n < len(whole) for n in found), found
