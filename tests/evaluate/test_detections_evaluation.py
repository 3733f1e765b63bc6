"""Detections beside graphs: what a field of view hides is told apart."""

import numpy as np
import pytest
from typer.testing import CliRunner

from semloc_core.cli import app
from semloc_core.evaluate import evaluate_detections
from semloc_core.evaluate.detections import WAYS, in_view, without
from semloc_core.graph import UpdateStream
from semloc_core.map_database import load
from semloc_core.sources import KINDS, SimulationConfig, draw_pair, simulate_traversal, write_world


@pytest.fixture(scope="module")
def home():
    return draw_pair(KINDS["home"], np.random.default_rng(5))


def test_cameras_all_around_see_more_than_one_and_what_none_sees_was_never_there(home):
    graph, seed = home[1].graph, [3]
    config = SimulationConfig.of(distance_m=8.0, shared_frame=True, fresh_ids=False)
    updates = [step.update for step in simulate_traversal(graph, config, np.random.default_rng(seed))]
    published = {thing.id for update in updates for thing in update.objects}
    one, around = (in_view(graph, updates, 8.0, cameras, seed) for cameras in (1, 6))
    assert one < around <= published
    assert in_view(graph, updates, 8.0, 1, seed) == one
    mapper = UpdateStream()
    for update in updates:
        mapper.apply(without(update, one))
    assert mapper.graph.objects.keys() == one
    assert mapper.graph.places.keys() == {place.id for update in updates for place in update.places}


def test_each_way_is_asked_on_the_same_walks(home, tmp_path):
    (tmp_path / "root" / "home").mkdir(parents=True)
    for name, world in zip(("map", "query"), home, strict=True):
        write_world(tmp_path / "root" / "home" / f"{name}.json", world)
    built = CliRunner().invoke(
        app, ["map", "build", str(tmp_path / "root" / "home" / "map.json"), "-o", str(tmp_path / "home.map")]
    )
    assert built.exit_code == 0, built.output
    loaded = load(tmp_path / "home.map")
    rows = evaluate_detections(tmp_path / "root", loaded, walks=2, metres=6.0, cameras=2, seed=1)
    assert [row["method"] for row in rows] == list(WAYS)
    assert all(row["queries"] == 2 for row in rows)
    known = {row["method"]: row["objects"] for row in rows}
    assert 0 < known["graphs, same field of view"] <= known["graphs"]
