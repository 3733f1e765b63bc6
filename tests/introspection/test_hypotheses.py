"""Verdicts on the paper's hypotheses: right where the truth is planted, undecided where there is nothing to see."""

import numpy as np
import pytest
from sklearn.metrics import average_precision_score
from small_building import SPACE, building_update, make_model

from semloc_core.evaluate.paper.office import office_variants
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.introspection.hypotheses import (
    COVERAGE,
    MODERATE,
    frequent_and_rare,
    hypothesis_rows,
    most_faithful,
    overall,
    verdict,
)
from semloc_core.introspection.mobility_study import MobilityRun, groups, mobility_study
from semloc_core.introspection.run import introspect_run
from semloc_core.metrics.intervals import bootstrap, squares
from semloc_core.metrics.weighted_precision import WeightedPrecision
from semloc_core.training.config import TrainConfig


def building(**options) -> GraphArrays:
    graph = SceneGraph()
    graph.apply(building_update(**options))
    return GraphArrays.from_scene_graph(graph, SPACE, "home")


def test_weighted_precision_is_scikit_learns():
    rng = np.random.default_rng(0)
    similarity = np.round(rng.random((12, 9)), 1).astype(np.float32)  # with many ties
    positive = rng.random((12, 9)) < 0.3
    ours = WeightedPrecision(similarity, positive)
    for weight in (np.ones(12), rng.integers(0, 3, 12).astype(float)):
        want = average_precision_score(positive.ravel(), similarity.ravel(), sample_weight=np.repeat(weight, 9))
        assert ours.of(weight) == pytest.approx(want)
    assert np.isnan(ours.of(np.zeros(12)))
    assert np.isnan(WeightedPrecision(similarity, np.zeros_like(positive)).of(np.ones(12)))


def test_frequent_and_rare_are_the_papers():
    counts = {"chair": 28, "couch": 11, "computer": 35, "plant": 13, "painting": 8, "trash can": 15}
    frequency = {name: n / 110 for name, n in counts.items()}
    assert frequent_and_rare(frequency, counts) == (["computer", "chair"], ["couch", "painting"])
    assert frequent_and_rare({"a": 0.5, "b": 0.5}, {"a": 1, "b": 1}) == (["a"], ["b"])


def test_verdicts():
    assert [verdict(MODERATE, *interval) for interval in ((0.5, 0.9), (1.1, 1.2), (0.9, 1.1))] == [
        "supported",
        "refuted",
        "undecided",
    ]
    assert verdict(COVERAGE, 0.1, 0.2) == "supported"
    assert verdict(COVERAGE, float("nan"), float("nan")) == "undecided"


def test_an_interval_is_as_wide_as_its_squares_allow():
    """Places of one square are one observation: the interval must not shrink because there are many of them."""
    rng = np.random.default_rng(0)
    values = np.repeat(rng.normal(size=20), 50)
    apart, together = [np.arange(1000)], [np.repeat(np.arange(20), 50)]

    def mean(run: int, weight: np.ndarray) -> float:
        return float(np.average(values, weights=weight))

    widths = []
    for of in (apart, together):
        figure, low, high = bootstrap(mean, of, 200, np.random.default_rng(1))
        assert low < figure < high
        widths.append(high - low)
    assert widths[1] > 4 * widths[0]
    assert squares(np.array([[0.0, 0, 0], [3.9, 3.9, 0], [4.1, 0, 0]])).tolist() == [0, 0, 1]


def test_rows_of_a_study():
    model, arrays = make_model("paper"), building(length=24, objects=16)
    runs = []
    for seed in (0, 1):
        query, reference = office_variants(arrays, SPACE, seed)
        runs.append(
            introspect_run(model, query, reference, seed=seed, methods=["attention", "saliency"], shift_places=2)
        )
    where = np.array([[4.0 * i, 0, 0] for i in range(30)])
    planted = {"attention": np.full(30, -0.2), "saliency": np.resize([-0.5, 0.5], 30)}
    mobility = [MobilityRun(("chair",), where, planted)]
    rows = hypothesis_rows(runs, ["attention", "saliency"], mobility, draws=50)
    assert hypothesis_rows(runs, ["attention", "saliency"], mobility, draws=50) == rows
    third = {row["method"]: row["verdict"] for row in rows if row["hypothesis"] == 3}
    assert third == {"attention": "supported", "saliency": "undecided"}
    best = most_faithful(runs, ["attention", "saliency"])
    assert overall(rows)[3] == third[best]
    assert {row["method"] for row in rows if row["decides"]} == {best, "ablation", "coverage"}
    assert 3 not in overall(hypothesis_rows(runs, ["attention", "saliency"], [], draws=5))
    # at every place shares sum to 1, so the lifts of all classes, weighted by what they'd have, do as well
    equal = [row["figure"] for row in rows if row["claim"] == MODERATE.words]
    assert all(0 < figure < 4 for figure in equal)


def test_the_experiment_repeats_and_moves_the_group_it_names():
    arrays = building(length=24, objects=30, seed=2)
    config = TrainConfig(steps=2, warmup_steps=0, validate_steps=2)
    told: list[str] = []

    def study():
        return mobility_study(
            arrays, SPACE, seeds=(0,), config=config, methods=["attention"], n_places=6,
            progress=lambda done, total, words: told.append(words),
        )  # fmt: skip

    one, again = study()[0], study()[0]
    np.testing.assert_array_equal(one.change["attention"], again.change["attention"])
    assert one.change["attention"].shape == (len(one.positions),)
    assert np.abs(one.change["attention"]).max() > 0
    assert {words for words in told if "moving" in words} == {
        f"traversals 1, {', '.join(group)} moving"
        for group in groups(
            {name: float(np.mean(arrays.object_classes == i)) for i, name in enumerate(SPACE.classes)}, SPACE
        )
    }


def test_the_group_is_what_is_known_to_move():
    space = Labelspace("s", ("a", "b", "c", "d"), mobility={"b": 0.5, "d": 0.5}, default_mobility=0.1)
    frequency = {"a": 0.4, "b": 0.3, "c": 0.2, "d": 0.1}
    assert groups(frequency, space) == (("b", "d"), ("a", "c"))
    assert groups(frequency, SPACE) == (("a", "c"), ("b", "d"))
