import numpy as np
import pytest
from small_building import building_update
from svg_marks import Marks

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.report.colours import OWN, ClassLooks
from semloc_core.report.floor_plan import Plan, building_figure, confusion_figure, path_figure, similarity_figure


@pytest.fixture
def plan() -> Plan:
    return Plan.of(SceneGraph.from_update(building_update(length=12, objects=9)), "home")


def none() -> np.ndarray:
    return np.zeros((0, 2))


def test_plan_has_every_place_edge_and_object(plan):
    assert plan.places.shape == (12, 2)
    assert plan.edges.shape == (11, 2, 2)
    assert np.allclose(np.linalg.norm(plan.edges[:, 0] - plan.edges[:, 1], axis=1), 1.0)
    assert sum(len(points) for points in plan.objects.values()) == 9
    assert [len(p) for p in plan.objects.values()] == sorted(map(len, plan.objects.values()), reverse=True)


def test_building_shows_each_object_in_the_style_of_its_class(plan):
    classes = list(plan.objects)
    marks = Marks(building_figure(plan, ClassLooks(classes, classes)))
    assert marks.count("places") == 12
    for number, name in enumerate(classes):
        assert marks.count(f"class-{number}") == len(plan.objects[name])
        assert f"{name} ({len(plan.objects[name])})" in marks.labels


def test_classes_beyond_those_a_legend_can_hold_are_drawn_together(plan):
    last = next(iter(plan.objects))
    order = [*"abcdefghijklmnop"[:OWN], *plan.objects]
    marks = Marks(building_figure(plan, ClassLooks(order, order)))
    assert marks.count("class-other") == 9
    assert "other classes (9)" in marks.labels
    assert not any(label.startswith(f"{last} (") for label in marks.labels)


def test_path_right_and_wrong_answers_are_told_apart_and_counted(plan):
    path = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (np.nan, np.nan), (4.0, 0.0), (5.0, 0.0)]
    marks = Marks(
        path_figure(plan, path, [True, False, False, False, True, True], [(0, 0), (4, 0)], [(9, 0)] * 3, none(), [])
    )
    assert (marks.count("right"), marks.count("wrong")) == (2, 1), "three answers on one place are one mark"
    assert {"put here rightly (2)", "put here wrongly (3)", "true path", "start", "end"} <= set(marks.labels)
    assert marks.count("path-right") == 2, "not across the gap"


def test_without_truth_answers_are_coloured_by_probability_and_no_path_is_claimed(plan):
    marks = Marks(path_figure(plan, none(), [], none(), none(), [(0, 0), (1, 0), (2, 0)], [0.1, 0.5, 0.9]))
    assert marks.count("unjudged") == 3
    assert {"put here (3)", "probability"} <= set(marks.labels)
    assert not {"true path", "start", "end"} & set(marks.labels)


def test_confusions_are_numbered(plan):
    marks = Marks(confusion_figure(plan, [(1, 0), (5, 0)], [7, 2], [1, 4]))
    assert marks.count("confusions") == 2
    assert {"1", "4"} <= set(marks.labels)


def test_similarity_colours_every_place_and_marks_the_query(plan):
    marks = Marks(similarity_figure(plan, np.linspace(-0.2, 1.0, 12), (3.0, 0.0)))
    assert (marks.count("similarity"), marks.count("objects"), marks.count("query")) == (12, 9, 1)
    assert {"cosine similarity", "the query", "object"} <= set(marks.labels)
    assert Marks(similarity_figure(plan, np.zeros(12))).count("query") == 0


def test_similarities_of_other_places_are_refused(plan):
    with pytest.raises(AssertionError):
        similarity_figure(plan, np.zeros(11))


@pytest.mark.parametrize("places", [np.zeros((0, 2)), np.array([[3.0, 4.0]])])
def test_a_building_of_no_or_one_place_can_be_drawn(places):
    plan = Plan("hut", places, np.zeros((0, 2, 2)), {})
    assert Marks(building_figure(plan, ClassLooks([], []))).count("places") == len(places)
