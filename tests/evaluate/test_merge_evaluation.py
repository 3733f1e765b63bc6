"""What merging is measured by: buildings that live, and the figures before and after."""

from __future__ import annotations

import math

import numpy as np
import pytest

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.evaluate.merge import evaluate_merge
from semloc_core.evaluate.merge_cases import LifeConfig, carry, home_cases, misplaced_m, world_cases
from semloc_core.graph.arrays import GraphArrays
from semloc_core.map_merge.transform import Transform

LIFE = LifeConfig(traversals=1, distance_m=0.0)


def test_a_merged_map_is_judged_beside_its_alternatives():
    space, cases = world_cases(2, 3, LIFE)
    model = Model(build_encoder("rings", None, len(space)), space)
    rows = evaluate_merge(space, cases, [("rings", model)])
    by_map = {(row["scope"], row["map"]): row for row in rows if "map" in row}
    assert {scope for scope, _ in by_map} == {"same detector", "another detector"}
    before = by_map["same detector", "first traversal"]
    assert before["gain"] == 0
    assert before["queries"] == sum(case.queries["same detector"].n_places for case in cases)
    itself = by_map["same detector", "first traversal merged with itself"]
    assert abs(float(itself["gain"])) < 0.01, "nothing was learnt, nothing is lost"
    after = by_map["same detector", "1 merged"]
    assert after["gain"] == pytest.approx(float(after["success@1"]) - float(before["success@1"]))
    tried = {row["scope"]: row for row in rows if "tried" in row}
    assert (tried["merges"]["accepted"], tried["merges"]["right"]) == (2, 2)
    assert tried["foreign"]["refused"] == 2
    learnt = {row["scope"]: row for row in rows if "moves_learnt" in row}
    assert learnt["chair"]["moves_true"] == pytest.approx(1 - math.exp(-space.mobility_of("chair")))


def test_traversals_come_in_frames_of_their_own_and_the_truth_leads_back():
    space, cases = world_cases(1, 0, LifeConfig(traversals=2, distance_m=40.0))
    for visit in cases[0].visits:
        arrays = GraphArrays.from_scene_graph(visit.graph, space)
        back = visit.truth.apply(arrays.place_positions)
        mapped = cases[0].first.place_positions
        nearest = np.linalg.norm(mapped[:, None] - back, axis=2).min(axis=0)
        assert np.quantile(nearest, 0.95) < 1.0
        assert arrays.n_places < 0.9 * cases[0].first.n_places, "a walk of 40 m does not see it all"
        assert misplaced_m(Transform(0.0, (0.0, 0.0, 0.0)), visit.truth, arrays.place_positions) > 1.0


def test_only_what_is_mobile_is_carried_and_not_far():
    space, cases = world_cases(1, 0, LIFE)
    graph = cases[0].first
    shares = dict.fromkeys(space.classes, 0.0) | {"chair": 1.0}
    later = carry(graph, space, shares, 5.0, np.random.default_rng(0))
    away = np.linalg.norm(later.object_positions - graph.object_positions, axis=1)
    chairs = graph.object_classes == space.index("chair")
    assert (away[~chairs] == 0).all()
    assert np.median(away[chairs]) > 1.0
    assert away.max() < 5.0 + 4.0
    assert sorted(later.object_parents[0].tolist()) == sorted(graph.object_parents[0].tolist())


@pytest.mark.data
def test_a_detectors_view_of_a_real_home_is_laid_on_its_map(data_root):
    """And not on another home's: real buildings, real detector, frame unknown."""
    space, cases = home_cases(data_root / "gibson", 0, LIFE)
    model = Model(build_encoder("rings", None, len(space)), space)
    rows = evaluate_merge(space, cases[:3], [("rings", model)])
    tried = {row["scope"]: row for row in rows if "tried" in row}
    assert (tried["merges"]["right"], tried["foreign"]["refused"]) == (3, 3)
