"""A wrong answer's picture holds what it is about: the robot, the answer, and what was seen."""

import numpy as np
import pytest
from small_building import building_update

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.report.floor_plan import Plan
from semloc_core.report.trust_figures import MARGIN_M, failure_figure


@pytest.mark.parametrize("answer", [(4.0, 1.0), (25.0, -18.0)])
def test_robot_and_answer_are_in_the_picture_wherever_they_are(answer: tuple[float, float]) -> None:
    plan = Plan.of(SceneGraph.from_update(building_update(length=12, objects=9)), "home")
    seen = {"chair": np.array([[3.0, 1.0], [5.0, 2.0]])}
    truth = (-14.0, 22.0)
    drawn = failure_figure(plan, plan, [(0.0, 0.0), truth], truth, answer, seen, seen, ["chair", "bed"])
    for axes, robot in zip(drawn.axes, (truth, answer), strict=True):
        every = np.array([robot, *seen["chair"]])
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert (every[:, 0] >= left + MARGIN_M - 1e-9).all()
        assert (every[:, 0] <= right - MARGIN_M + 1e-9).all()
        assert (every[:, 1] >= low + MARGIN_M - 1e-9).all()
        assert (every[:, 1] <= high - MARGIN_M + 1e-9).all()
