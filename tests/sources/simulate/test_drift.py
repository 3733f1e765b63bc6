"""A frame that drifts: by how much, about what, and what is written in it."""

import math

import numpy as np
import pytest

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources.simulate import SimulationConfig, simulate_traversal
from semloc_core.sources.simulate.drift import Frame
from semloc_core.sources.simulate.walks import WalkConfig, walk
from semloc_core.sources.world import KINDS, draw_pair


@pytest.fixture(scope="module")
def home():
    return draw_pair(KINDS["home"], np.random.default_rng(11))[0]


def test_the_frame_turns_about_the_robot_and_shifts_as_said():
    here, steps = np.array([4.0, -2.0, 0.5]), 4000
    rng = np.random.default_rng(0)
    frames = [Frame(0.3, (1.0, 2.0, 0.0)).drifted(here, 0.25, rng) for _ in range(steps)]
    turns = np.degrees([frame.yaw - 0.3 for frame in frames])
    shifts = np.array([frame.of(here) - Frame(0.3, (1.0, 2.0, 0.0)).of(here) for frame in frames])
    assert turns.std() == pytest.approx(0.5 * math.sqrt(0.25), rel=0.05)
    np.testing.assert_allclose(shifts.std(axis=0), 0.03 * math.sqrt(0.25), rtol=0.05)


def test_a_run_writes_what_it_sees_in_the_frame_as_it_then_is(home):
    config = SimulationConfig.of(
        distance_m=25.0, drift=1.0, shared_frame=True, fresh_ids=False, miss_rate=0.0, false_rate=0.0,
        position_noise_m=0.0, frame_id="home",
    )  # fmt: skip
    graph, moved = SceneGraph(), 0
    for step in simulate_traversal(home.graph, config, np.random.default_rng(2)):
        graph.apply(step.update)
        odometry = step.update.odometry
        assert odometry.frame_id == step.update.frame_id == "home"
        # The robot's own place is written now: its offset from the robot is the true one, turned with the frame.
        yaw = 2 * math.atan2(odometry.orientation_xyzw[2], odometry.orientation_xyzw[3]) - step.heading
        true = np.subtract(home.graph.places[step.place], step.position)
        written = np.subtract(graph.places[step.place], odometry.position)
        c, s = math.cos(yaw), math.sin(yaw)
        np.testing.assert_allclose(written, [c * true[0] - s * true[1], s * true[0] + c * true[1], true[2]], atol=1e-9)
        moved = max(moved, math.dist(odometry.position, step.position))
    assert moved > 0.02


def test_a_walk_without_drift_is_the_walk_it_was(home):
    arrays = GraphArrays.from_scene_graph(home.graph, home.labelspace)
    still, drifts = (
        walk(arrays, WalkConfig(distance_m=20.0, drift=drift), np.random.default_rng(4)) for drift in (0.0, 1.0)
    )
    np.testing.assert_array_equal(still.places, drifts.places)
    np.testing.assert_array_equal(still.seen_objects, drifts.seen_objects)
    last = still.steps - 1
    part, place = still.part(last)
    assert {tuple(p) for p in part.place_positions.tolist()} <= {tuple(p) for p in arrays.place_positions.tolist()}
    frame = drifts.frame(last)
    moved, place = drifts.part(last)
    np.testing.assert_allclose(moved.place_positions[place], frame.of(arrays.place_positions[drifts.places[last]]))
    assert drifts.drift(last) == pytest.approx(1.0, abs=0.6)
    assert still.drift(last) is None
    assert (drifts.ages(last) <= still.ages(last)).all()
