"""The paper's protocol on a building of sixty places: what is compared with what, and that a rerun says the same."""

import dataclasses

import msgspec
import numpy as np
import pytest

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.encoding.similarity import similarity_matrix
from semloc_core.evaluate.paper.ablation import VARIANTS, evaluate_ablation
from semloc_core.evaluate.paper.office import evaluate_office, judge_baseline, judge_model, office_variants
from semloc_core.graph.arrays import GraphArrays
from semloc_core.metrics import precision_recall as metrics
from semloc_core.sources.world import World
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.split import positive_pairs, split_places

STILL = PerturbConfig(mobility_scale=0.0)
QUICK = TrainConfig(steps=4, validate_steps=2, pool=2)
NEAR_M = 1.5  # in so small a building nearly everything lies within 4 m
FIGURES = ("pr_auc", "f1", *(f"{figure}@{n}" for figure in ("recall", "recall_ceiling", "success") for n in (1, 5, 10)))


def test_the_fixture_is_as_small_as_it_says(small_arrays: GraphArrays) -> None:
    assert 40 <= small_arrays.n_places <= 110


def test_rows_are_those_of_table_ii(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    calls: list[tuple[int, int]] = []
    rows = evaluate_office(
        small_arrays,
        small_worlds[0].labelspace,
        losses=("infonce", "triplet"),
        seeds=(0, 1),
        config=QUICK,
        progress=lambda done, total, words: calls.append((done, total)),
    )
    assert [(row["method"], row["loss"], row["scope"]) for row in rows] == [
        (method, loss, scope)
        for method, loss in (("paper", "infonce"), ("paper", "triplet"), ("bag_of_words", None))
        for scope in ("val", "test")
    ]
    for row in rows:
        for figure in FIGURES:
            assert 0.0 <= float(row[figure] or 0.0) <= 1.0
            assert float(row[f"{figure}_std"] or 0.0) >= 0.0
        for n in (1, 5, 10):
            assert float(row[f"recall@{n}"] or 0) <= float(row[f"recall_ceiling@{n}"] or 0) + 1e-9
    done = [d for d, _ in calls]
    assert done == sorted(done)
    assert {total for _, total in calls} == {16}
    assert done[-1] == 16


def test_a_rerun_says_the_same(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    space = small_worlds[0].labelspace
    runs = [evaluate_office(small_arrays, space, losses=("infonce",), seeds=(3,), config=QUICK) for _ in range(2)]
    assert runs[0] == runs[1]


def test_figures_are_of_the_split_against_the_same_split_of_the_other_variant(
    small_arrays: GraphArrays, small_worlds: list[World]
) -> None:
    """Computed a second time, from nothing but ids and positions."""
    space = small_worlds[0].labelspace
    split = split_places(small_arrays, 0)
    query, reference = office_variants(small_arrays, space, 0)
    model = Model(build_encoder("bag_of_words", None, len(space)), space)
    found = judge_model(model, (query, reference), split, 4.0)
    pairs = {}
    for scope, part in (("val", "validation"), ("test", "test")):
        mask = split.mask(part)
        similarity = similarity_matrix(embed_graph(model, query)[mask], embed_graph(model, reference)[mask])
        positions = small_arrays.place_positions[mask]
        pairs[scope] = similarity, positive_pairs(positions, positions, 4.0)
    threshold = metrics.fit_threshold(*pairs["val"])
    for scope, (similarity, positive) in pairs.items():
        assert found[scope]["pr_auc"] == pytest.approx(metrics.pr_auc(similarity, positive))
        assert found[scope]["f1"] == pytest.approx(metrics.f1_at(similarity, positive, threshold))
        assert found[scope]["queries"] == len(similarity)


def test_the_two_variants_differ_and_depend_on_the_seed(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    space = small_worlds[0].labelspace
    first, second = office_variants(small_arrays, space, 0)
    again, _ = office_variants(small_arrays, space, 0)
    other, _ = office_variants(small_arrays, space, 1)
    assert not np.array_equal(first.object_positions, second.object_positions)
    assert np.array_equal(first.object_positions, again.object_positions)
    assert not np.array_equal(first.object_positions, other.object_positions)


def test_what_did_not_move_is_found_by_rings(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    """Each place's own copy is in the database, so anything but 1 means that rows and columns are mixed up."""
    (found,) = judge_baseline(small_arrays, small_worlds[0].labelspace, (0,), STILL, "rings")
    assert found["test"]["success@1"] == found["val"]["success@1"] == 1.0


def test_a_scrambled_map_is_not_found(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    """A check that can fail: embeddings that belong to other places score no better than chance."""
    space = small_worlds[0].labelspace
    query, reference = office_variants(small_arrays, space, 0, STILL)
    order = np.random.default_rng(0).permutation(small_arrays.n_places)
    parents = np.stack([reference.object_parents[0], order[reference.object_parents[1]]])
    scrambled = dataclasses.replace(reference, object_parents=parents)
    model = Model(build_encoder("rings", None, len(space)), space)
    split = split_places(small_arrays, 0)
    right = judge_model(model, (query, reference), split, NEAR_M)["val"]["pr_auc"]
    wrong = judge_model(model, (query, scrambled), split, NEAR_M)["val"]["pr_auc"]
    assert wrong < right - 0.2


def test_ablation_has_the_rows_of_table_iii() -> None:
    assert [options for _, options in VARIANTS] == [
        {"layers": 1},
        {"layers": 3},
        {"hidden": 32},
        {"hidden": 128},
        {"heads": 1},
        {"heads": 2},
        {"gat": False},
        {"gat": False, "layers": 3},
        {},
    ]


def test_ablation_judges_what_it_says(small_arrays: GraphArrays, small_worlds: list[World]) -> None:
    config = msgspec.structs.replace(QUICK, positive_radius_m=NEAR_M)
    chosen = [variant for variant in VARIANTS if variant[0] in ("1 layer", "no GAT, 2 layers", "paper")]
    rows = evaluate_ablation(small_arrays, small_worlds[0].labelspace, seeds=(0,), config=config, variants=chosen)
    assert [(row["method"], row["layers"], row["hidden"], row["heads"]) for row in rows] == [
        ("1 layer", 1, 64, 3),
        ("no GAT, 2 layers", 2, 64, None),
        ("paper", 2, 64, 3),
    ]
    assert {row["scope"] for row in rows} == {"test"}
    assert len({row["pr_auc"] for row in rows}) == 3, "three models can't score the same to the last digit"
