"""The study over a whole map: what each figure is, on cases where it is known."""

import numpy as np
import pytest
import torch
from small_building import SPACE, building_update, make_model

from semloc_core.encoding.model import embed_graph
from semloc_core.encoding.place_graph.cut import PlaceBatches
from semloc_core.errors import ConfigError
from semloc_core.evaluate.paper.office import office_variants
from semloc_core.explain.explainers.by_name import CONTROLS, EXPLAINERS
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.introspection.agreement.ranks import concordance, kendall_w, spearman
from semloc_core.introspection.agreement.rows import (
    ALL_EXPLAINERS,
    agreement_rows,
    explainer_rows,
    frequency_rows,
    inverse_document_frequency,
)
from semloc_core.introspection.class_ablation import (
    ablate_classes,
    class_frequencies,
    importance_shift,
    spread,
    without_class,
)
from semloc_core.introspection.controls import control_rows
from semloc_core.introspection.rows import ranking_rows, table_rows
from semloc_core.introspection.run import ABLATION, importance_without, introspect_run
from semloc_core.introspection.study import introspect
from semloc_core.introspection.whole_map import introspect_map, shares
from semloc_core.metrics.table import document
from semloc_core.training.config import TrainConfig


def building(**options) -> GraphArrays:
    graph = SceneGraph()
    graph.apply(building_update(**options))
    return GraphArrays.from_scene_graph(graph, SPACE, "home")


@pytest.mark.parametrize("name", ["paper", "rings", "bag_of_words"])
def test_a_place_cut_out_has_the_embedding_it_has_in_the_building(name):
    model, arrays = make_model(name), building()
    whole = embed_graph(model, arrays)
    batches = PlaceBatches(arrays, len(SPACE), model.encoder.extraction)
    for place in range(arrays.n_places):
        batch = batches.of(place)
        assert batch.node_ids[0] == arrays.place_ids[place]
        with torch.inference_mode():
            np.testing.assert_allclose(model.encoder(batch)[0].numpy(), whole[place], atol=1e-5)


def test_a_lone_place_can_be_cut_out():
    model, arrays = make_model("paper"), building(length=1, objects=0, query=None)
    batch = PlaceBatches(arrays, len(SPACE), model.encoder.extraction).of(0)
    assert (batch.n_nodes, batch.nodes_within) == (1, (1, 1, 1, 1))


def test_importance_is_the_mean_share_and_only_of_what_is_in_reach():
    model, arrays = make_model("rings"), building(objects=3, length=60)
    other = office_variants(arrays, SPACE, 0)[0]
    found = introspect_map(model, other, arrays, methods=["attention", "class_shapley"], with_fidelity=False)
    for values in found.importance.values():
        assert values.sum() == pytest.approx(1)
        assert (values >= 0).all()
    alone = introspect_map(model, other, arrays, methods=["attention"], places=[int(found.places[0])])
    assert set(alone.fidelity) == {"attention", "inverted", *CONTROLS}
    assert introspect_map(model, other, arrays, methods=["attention"], places=[]).places.shape == (0,)


def test_a_place_is_explained_alike_whoever_else_is():
    model, arrays = make_model("paper"), building()
    other = office_variants(arrays, SPACE, 0)[0]
    both = introspect_map(model, other, arrays, methods=["shapley_sampling"], places=[4, 9], with_fidelity=False)
    each = [
        introspect_map(model, other, arrays, methods=["shapley_sampling"], places=[p], with_fidelity=False)
        for p in (4, 9)
    ]
    mean = np.mean([one.importance["shapley_sampling"] for one in each], axis=0)
    np.testing.assert_allclose(both.importance["shapley_sampling"], mean, atol=1e-6)


def test_class_ablation_is_the_loss_of_pr_auc():
    """Removing what all places see costs nothing; removing what tells them apart costs most of it."""
    model, arrays = make_model("bag_of_words"), building(objects=40)
    drop = ablate_classes(model, arrays, arrays)
    assert set(drop) == set(class_frequencies(arrays, SPACE)) == set(SPACE.classes)
    everywhere, here_and_there = (chairs_of(building(objects=o, length=n)) for o, n in ((40, 30), (8, 60)))
    assert class_frequencies(everywhere, SPACE) == {"chair": 1.0}
    assert ablate_classes(model, everywhere, everywhere)["chair"] == pytest.approx(0)
    assert ablate_classes(model, here_and_there, here_and_there)["chair"] > 0.05


def chairs_of(arrays: GraphArrays) -> GraphArrays:
    for name in SPACE.classes[1:]:
        arrays = without_class(arrays, SPACE, name)
    return arrays


def test_shift_by_hand():
    half, one, other = np.array([0.5, 0.5]), np.array([1.0, 0.0]), np.array([0.0, 1.0])
    assert importance_shift(half, half) == 0
    assert importance_shift(one, other) == pytest.approx(1)  # a bit
    m = np.array([0.75, 0.25])
    want = 0.5 * (np.log2(1 / 0.75)) + 0.5 * np.sum(half * np.log2(half / m))
    assert importance_shift(one, half) == pytest.approx(want)
    assert importance_shift(np.array([4.0, 2, 2]), np.array([0.0, 3, 3]), np.array([False, True, True])) == 0
    assert np.isnan(importance_shift(one, other, np.array([True, False])))
    assert spread(np.array([1.0, 2.0]), ["c", "a"], ["a", "b", "c"]).tolist() == [2, 0, 1]
    assert shares(np.array([-3.0, 1.0])).tolist() == [0.75, 0.25]
    assert shares(np.zeros(4)).tolist() == [0.25] * 4


def test_kendall_w():
    assert kendall_w([[1, 2, 3, 4]] * 3) == pytest.approx(1)
    assert kendall_w([[1, 2, 3], [2, 3, 1], [3, 1, 2]]) == pytest.approx(0)
    # Legendre 2005: W = 12 S / (m² (n³ - n)); rank sums 4, 3, 5, 8 of two raters have S = 14
    assert kendall_w([[1, 2, 3, 4], [3, 1, 2, 4]]) == pytest.approx(12 * 14 / (4 * 60))
    assert np.isnan(kendall_w([[1, 1, 1], [2, 2, 2]]))
    with pytest.raises(ConfigError, match="at least 2 raters on 3 items"):
        kendall_w([[1, 2, 3]])


def test_spearman():
    rho, low, high = spearman([1, 2, 3, 4, 5, 6], [2, 1, 4, 3, 6, 5])
    assert rho == pytest.approx(1 - 6 * 6 / (6 * 35))
    assert -1 < low < rho < high < 1
    assert spearman([1, 2, 3], [3, 2, 1])[0] == pytest.approx(-1)
    assert np.isnan(spearman([1, 1, 1, 1], [1, 2, 3, 4])[0])
    assert spearman([1, 2, 3, 4, np.nan], [4, 3, 2, 1, 0])[0] == pytest.approx(-1)


def test_five_ranks_in_one_order_are_no_proof():
    """All five agreeing is one order of 120: an interval without width would call it certain."""
    rho, low, high = spearman([1, 2, 3, 4, 5], [2, 4, 6, 8, 10])
    assert (rho, high) == (pytest.approx(1), pytest.approx(1))
    assert 0 < low < 0.6


def test_agreement_by_chance_is_not_zero():
    """Three raters who draw lots have a W of a third on average; a W of a third must not pass for agreement."""
    rng = np.random.default_rng(0)
    drawn = [kendall_w(rng.permuted(np.tile(np.arange(6.0), (3, 1)), axis=1)) for _ in range(300)]
    said = concordance([[1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1], [2, 1, 4, 3, 6, 5]])
    assert np.mean(drawn) == pytest.approx(said.by_chance, abs=0.03)
    assert said.p > 0.2
    assert concordance([[1, 2, 3, 4, 5, 6]] * 3).p < 0.01
    assert np.isnan(concordance([[1, 1, 1], [2, 2, 2]]).p)


def test_a_run_and_its_rows():
    model, arrays = make_model("paper"), building(length=12, objects=12)
    runs = []
    for seed in (0, 1):
        query, reference = office_variants(arrays, SPACE, seed)
        runs.append(introspect_run(model, query, reference, seed=seed, places=range(0, 12, 4), shift_places=2))
    methods = list(EXPLAINERS)
    rows = table_rows(runs, methods)
    for method in (ABLATION, *methods):
        ranked = [row for row in rows if row["method"] == method and row.get("run") == 1 and "rank" in row]
        assert [row["rank"] for row in ranked] == list(range(1, len(ranked) + 1))
        scores = [row["score"] for row in ranked]
        assert scores == sorted(scores, reverse=True)
        for row in ranked:
            part = row["pr_auc_drop"] if method == ABLATION else row["shift"]
            assert row["score"] == pytest.approx(part / row["frequency"])
    assert {row["method"] for row in rows if "budget" in row} == {*methods, *CONTROLS, "inverted"}
    table = ranking_rows(runs, methods)
    assert [(row["method"], row["scope"]) for row in table[:3]] == [
        (ABLATION, "run 1"),
        (ABLATION, "run 2"),
        (methods[0], "run 1"),
    ]
    assert all({row[str(rank)] for rank in range(1, 5)} == set(SPACE.classes) for row in table)  # each class once
    agreement = agreement_rows(runs, methods)
    assert [row["method"] for row in agreement] == [ABLATION, *methods, ALL_EXPLAINERS, ALL_EXPLAINERS]
    assert all(0 <= row["kendall_w"] <= 1 and 0 < row["p"] <= 1 for row in agreement)
    assert {row["by_chance"] for row in agreement} == {1 / 2, 1 / len(methods)}
    assert ALL_EXPLAINERS not in {row["method"] for row in agreement_rows(runs, methods[:1])}
    between = explainer_rows(runs, methods)
    assert len(between) == len(methods) * (len(methods) + 1) // 2
    assert all(row["method"] != row["other"] and -1 <= row["spearman"] <= 1 for row in between)
    of_frequency = frequency_rows(runs, methods)
    assert [row["method"] for row in of_frequency] == [ABLATION, *methods]
    assert all(row["frequency_low"] <= row["frequency"] <= row["frequency_high"] for row in of_frequency)
    controls = control_rows(runs, methods, draws=20)
    assert [(row["method"], row["scope"]) for row in controls] == [
        (method, f"against {control}") for control in (*CONTROLS, "inverted") for method in methods
    ]
    for row in controls:
        mean = np.mean([run.introspection.characterisation[row["method"]].mean() for run in runs])
        other = np.mean(
            [run.introspection.characterisation[row["scope"].removeprefix("against ")].mean() for run in runs]
        )
        assert row["better_by"] == pytest.approx(mean - other)


def test_a_control_that_is_the_explainer_itself_is_not_beaten():
    model, arrays = make_model("paper"), building(length=12, objects=12)
    run = introspect_run(model, *office_variants(arrays, SPACE, 0), methods=["saliency"], shift_places=2)
    scores = run.introspection.characterisation
    object.__setattr__(run.introspection, "characterisation", {**scores, "random": scores["saliency"]})
    row = control_rows([run], ["saliency"], draws=20)[0]
    assert (row["better_by"], row["verdict"]) == (0, "no better")


def test_a_word_in_every_text_says_nothing():
    model, arrays = make_model("rings"), building(length=24, objects=12)
    run = introspect_run(model, *office_variants(arrays, SPACE, 0), methods=["attention"], shift_places=2)
    for name in run.frequency:
        part = run.introspection.seen[:, run.query.object_classes == SPACE.index(name)].any(1).mean()
        assert inverse_document_frequency(run, name) == pytest.approx(-np.log(part))


def test_places_without_the_class_in_reach_need_not_be_explained_again():
    """What is taken over from before must be what explaining anew would give."""
    model, arrays = make_model("paper"), building(length=60, objects=8)
    query, reference = office_variants(arrays, SPACE, 0)
    methods = ["saliency", "shapley_sampling", "attention"]
    before = introspect_map(model, query, reference, methods=methods, with_fidelity=False)
    taken_over = 0
    for name in SPACE.classes:
        member = query.object_classes == SPACE.index(name)
        taken_over += int((~before.seen[:, member].any(1)).sum())
        found = importance_without(model, query, reference, name, before, methods, 0, lambda *_: None, "")
        a, b = without_class(query, SPACE, name), without_class(reference, SPACE, name)
        anew = introspect_map(model, a, b, methods=methods, with_fidelity=False).importance
        for method in methods:
            want = spread(anew[method], a.object_ids, query.object_ids)
            np.testing.assert_allclose(found[method], want, atol=1e-5)
    assert taken_over > 0


def test_the_whole_study_trains_explains_and_repeats():
    arrays = building(length=24, objects=30, seed=2)
    told: list[str] = []
    config = TrainConfig(steps=3, warmup_steps=0, validate_steps=3)

    def study():
        return introspect(
            arrays, SPACE, seeds=(0, 1), config=config, methods=["attention", "saliency"], shift_places=2, moved_m=None,
            sanity_places=2, progress=lambda done, total, words: told.append(words),
        )  # fmt: skip

    found = study()
    assert document("introspect", 0, [], found.rows) == document("introspect", 0, [], study().rows)
    assert {"run 1, training", "run 2", "run 1, without chair", "run 2, gat shuffled"} <= set(told)
    methods = {row["method"] for row in found.rows}
    assert methods == {ABLATION, ALL_EXPLAINERS, "attention", "saliency", "random", "inverted", "coverage"}
    ways = {row["way"] for row in found.rows if "way" in row}
    assert ways == {"cascading", "alone"}
