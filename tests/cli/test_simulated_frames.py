"""The frames of a simulated run: its updates' drifts with `--drift`, its truth is the building's all the same."""

import pytest

from semloc_core import wire
from semloc_core.sources import read_run


@pytest.mark.parametrize(("drift", "frame"), [("0", "home"), ("3", "odom")])
def test_the_truth_is_in_the_buildings_frame(semloc, write_corridor, tmp_path, drift, frame) -> None:
    graph, run = write_corridor(tmp_path / "home.json", ["chair", "couch", "lamp"] * 4), tmp_path / "run.mcap"
    assert semloc("bag", "simulate", graph, "--distance", "20", "--drift", drift, "-o", run).code == 0
    items = list(read_run(run))
    assert {item.truth.frame_id for item in items if item.truth is not None} == {"home"}
    updates = [wire.decode_update(item.text) for item in items]
    assert {update.frame_id for update in updates} == {frame}
    assert {update.odometry.frame_id for update in updates if update.odometry is not None} == {frame}
    last = items[-1].truth
    assert last is not None
    assert last.position[1] == 0.0  # on the corridor
    assert (updates[-1].odometry.position[1] == 0.0) == (drift == "0")
