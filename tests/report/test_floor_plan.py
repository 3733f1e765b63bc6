import numpy as np
import pytest
from small_building import building_update
from svg_marks import Marks

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.report.floor_plan import Plan, similarity_figure


@pytest.fixture
def plan() -> Plan:
    return Plan.of(SceneGraph.from_update(building_update(length=12, objects=9)), "home")


def test_plan_has_every_place_edge_and_object(plan):
    assert plan.places.shape == (12, 2)
    assert plan.edges.shape == (11, 2, 2)
    assert np.allclose(np.linalg.norm(plan.edges[:, 0] - plan.edges[:, 1], axis=1), 1.0)
    assert sum(len(points) for points in plan.objects.values()) == 9
    assert [len(p) for p in plan.objects.values()] == sorted(map(len, plan.objects.values()), reverse=True)


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
    assert Marks(similarity_figure(plan, np.zeros(len(places)))).count("places") == len(places)
