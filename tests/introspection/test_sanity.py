"""Sanity checks of explanations: they must be able to fail."""

import numpy as np
import pytest
import torch
from small_building import SPACE, building_update, make_model

from semloc_core.evaluate.paper.office import office_variants
from semloc_core.explain.explainers.by_name import EXPLAINERS
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.introspection.sanity import baseline_rows, mean_rows, randomisation_rows, sanity_rows


@pytest.fixture(scope="module")
def variants():
    graph = SceneGraph()
    graph.apply(building_update(length=12, objects=14))
    return office_variants(GraphArrays.from_scene_graph(graph, SPACE, "home"), SPACE, 0)


def test_every_layer_is_shuffled_both_ways_and_the_model_left_alone(variants):
    model = make_model("paper")
    before = model.hash
    rows = randomisation_rows(model, *variants, [2, 8], methods=["saliency"])
    assert model.hash == before
    layers = ["embed", "gat", "layers.1", "layers.0", "project"]
    assert [(row["way"], row["scope"]) for row in rows] == [(w, x) for w in ("cascading", "alone") for x in layers]
    assert all(-1 <= row["spearman"] <= 1 for row in rows)


def test_an_explainer_that_ignores_the_model_is_found_out(variants, monkeypatch):
    """Scores by object id stay the same whatever the weights: a correlation of 1 at every layer."""
    by_id = {"blind": lambda query, rng: query.scores("blind", np.arange(query.n_objects, dtype=float))}
    monkeypatch.setitem(EXPLAINERS, "blind", by_id["blind"])
    rows = randomisation_rows(make_model("paper"), *variants, [2, 8], methods=["blind", "integrated_gradients"])
    blind = [row["spearman"] for row in rows if row["method"] == "blind"]
    looks = [row["spearman"] for row in rows if row["method"] == "integrated_gradients"]
    np.testing.assert_allclose(blind, 1)
    assert min(looks) < 0.9


def test_baselines(variants):
    rows = baseline_rows(make_model("paper"), *variants, [2, 8])
    assert [row["scope"] for row in rows] == ["zero", "uniform", "mean", "zero, 400 steps"]
    assert rows[3]["gap"] <= rows[0]["gap"] + 1e-5
    assert rows[0]["spearman"] == pytest.approx(1)
    assert all(row["gap"] < 0.05 for row in rows)
    assert torch.is_grad_enabled()


def test_both_checks_of_several_runs(variants):
    model, explained = make_model("paper"), np.array([1, 4, 8])
    rows = []
    for run in (1, 2):
        rows += sanity_rows(
            model, *variants, explained, run=run, methods=["integrated_gradients"], n_places=2, seed=run
        )
    assert {row["run"] for row in rows} == {1, 2}
    mean = mean_rows(rows)
    assert len(mean) == len(rows) // 2 == 14
    for row in mean:
        key = ("method", "scope", "way")
        same = [r["spearman"] for r in rows if all(r[k] == row[k] for k in key)]
        assert row["spearman"] == pytest.approx(np.mean(same))
    assert not [
        row for row in sanity_rows(model, *variants, explained, methods=["saliency"]) if row["way"] == "baseline"
    ]
