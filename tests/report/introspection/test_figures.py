import numpy as np
import pytest
from svg_marks import Marks

from semloc_core.report.colours import ClassLooks
from semloc_core.report.introspection.figures import (
    FidelityCurves,
    fidelity_figure,
    importance_figure,
    matrix_figure,
    randomisation_figure,
    shift_figure,
)
from semloc_core.report.introspection.trust import layer_name


def test_a_matrix_has_its_title_and_its_scale():
    marks = Marks(matrix_figure("bag of words", np.random.default_rng(0).random((30, 30))))
    assert {"bag of words", "query", "place"} <= set(marks.labels)
    assert marks.count("matrix") == 1


def test_what_is_no_matrix_is_refused():
    with pytest.raises(AssertionError):
        matrix_figure("a", np.ones(3))


def test_importance_has_a_mark_for_each_object_of_each_explainer():
    classes = ["chair"] * 5 + ["plant"] * 2
    scores = {"saliency": np.arange(7.0), "attention": np.arange(7.0)[::-1]}
    marks = Marks(importance_figure(classes, scores, ClassLooks(["chair", "plant"], ["chair", "plant"])))
    for panel in (0, 1):
        assert (marks.count(f"objects-{panel}-0"), marks.count(f"objects-{panel}-1")) == (5, 2)
    assert {"saliency", "attention", "chair", "plant"} <= set(marks.labels)


def test_importance_of_nothing_but_zeros_can_be_drawn():
    assert (
        Marks(importance_figure(["chair"], {"saliency": np.zeros(1)}, ClassLooks(["chair"], ["chair"]))).count(
            "objects-0-0"
        )
        == 1
    )


def test_fidelity_has_each_explainer_in_each_panel_and_says_what_is_a_control():
    budgets = np.linspace(0.1, 1.0, 6)
    curves = {
        "integrated gradients": FidelityCurves(budgets, 1 - budgets, budgets),
        "attention": FidelityCurves(budgets, 1 - budgets, budgets),
        "random": FidelityCurves(budgets, 1 - budgets, budgets, control=True),
    }
    marks = Marks(fidelity_figure(budgets, curves))
    for attribute in ("necessity", "sufficiency", "characterisation"):
        assert [marks.count(f"{attribute}-{i}") for i in range(3)] == [6, 6, 1], "markers on curves, none on controls"
    assert {"integrated gradients", "attention", "random (control)"} <= set(marks.labels)


def test_a_curve_of_another_length_is_refused():
    with pytest.raises(AssertionError):
        fidelity_figure([0.1, 0.2], {"a": FidelityCurves(np.ones(2), np.ones(3), np.ones(2))})


def test_shift_names_each_class_at_its_marks_and_gives_the_correlation():
    marks = Marks(
        shift_figure(
            ClassLooks(["chair", "couch"], ["couch", "chair"]),
            [[1, 2, 3], [2, 3, 4]],
            [[1, 1, 2], [0, 1, 0]],
            "ρ = 0.8 [0.1, 0.9]",
        )
    )
    assert (marks.count("class-0"), marks.count("class-1")) == (3, 3)
    assert {"couch", "chair", "ρ = 0.8 [0.1, 0.9]"} <= set(marks.labels)


def test_randomisation_starts_at_the_model_as_it_is():
    marks = Marks(randomisation_figure(["embed", "gat"], {"saliency": [0.5, 0.1], "class_shapley": [0.4, -0.1]}))
    assert (marks.count("shuffled-0"), marks.count("shuffled-1")) == (3, 3)
    assert {"none", "+ embed", "+ gat", "saliency", "class shapley"} <= set(marks.labels)


def test_layers_have_names_for_readers() -> None:
    names = [layer_name(layer) for layer in ("project", "layers.0", "layers.1", "gat", "embed", "some_part")]
    assert names == ["input", "messages 1", "messages 2", "attention", "output", "some part"]
