"""Recall of candidates: the right place among the first N, for whole graphs and for what a walk has shown."""

import pytest

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import FileFormatError
from semloc_core.evaluate.candidates import RANKS, evaluate_candidates
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.sources.world import Furniture, OfficeConfig, RoomKind, make_world_pair, write_world

SMALL = OfficeConfig(
    rooms=(RoomKind("office", 3, (3.5, 4.5)),),
    furniture=(
        Furniture("couch", 6, "wall", (0.6, 0.6, 0.8), 0.4, rooms=("office",)),
        Furniture("plant", 6, "wall", (0.4, 0.4, 0.8), 0.5, rooms=("office",)),
    ),
    depth_m=4.0,
    spacing_m=(0.7, 1.0),
    max_edge_m=2.5,
)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    import numpy as np

    folder = tmp_path_factory.mktemp("town")
    for i in range(2):
        mapped, seen = make_world_pair(SMALL, np.random.default_rng([4, i]))
        (folder / f"b{i}").mkdir()
        write_world(folder / f"b{i}" / "map.json", mapped)
        write_world(folder / f"b{i}" / "query.json", seen)
    return folder


def test_more_candidates_hold_the_right_place_more_often_and_all_methods_are_asked_the_same(root) -> None:
    deaf = Model(build_encoder("rings", None, 1), Labelspace("deaf", ("couch",)))
    rows = evaluate_candidates(root, models=[("deaf", deaf)], baselines=["rings"], metres=(0.0, 5.0), walks=3)
    found = {(row["method"], row["scope"]): row for row in rows}
    assert set(found) == {(m, s) for m in ("rings", "deaf") for s in ("whole", "0 m", "5 m")}
    for row in rows:
        figures = [row[f"success@{n}"] for n in RANKS]
        assert figures == sorted(figures)
        assert row["success@1_low"] <= row["success@1"] <= row["success@1_high"]
    for scope in ("whole", "0 m", "5 m"):
        assert found["rings", scope]["queries"] == found["deaf", scope]["queries"]
        assert found["rings", scope]["unknown"] == 0
        assert 0.2 < found["deaf", scope]["unknown"] < 0.8, "objects of classes that a method lacks are counted"
    assert found["rings", "0 m"]["queries"] == 6
    assert found["rings", "whole"]["success@1"] > found["rings", "0 m"]["success@1"]
    assert rows == evaluate_candidates(root, models=[("deaf", deaf)], baselines=["rings"], metres=(0.0, 5.0), walks=3)


def test_a_folder_without_buildings_is_refused(tmp_path) -> None:
    with pytest.raises(FileFormatError, match=r"map\.json"):
        evaluate_candidates(tmp_path)
