"""Refined poses: exact where the objects are, blind to what was moved, honest about what is not known."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_core.evaluate.verified_answers import any_frame, layout_verifier, written_in
from semloc_core.graph.arrays import GraphArrays
from semloc_core.matching.layout import LayoutConfig, fragment_of_arrays
from semloc_core.matching.layout.pose.placed import placed
from semloc_core.metrics.pose_error import PoseErrors
from semloc_core.sources.simulate.walks import WalkConfig, walk

CONFIG = LayoutConfig()
NONE = np.zeros((2, 0), dtype=np.int64)


def building(objects, classes, places):
    objects, places = np.array(objects, dtype=float).reshape(-1, 3), np.array(places, dtype=float)
    ids = tuple(f"o{i}" for i in range(len(objects)))
    places_ids = tuple(f"p{i}" for i in range(len(places)))
    return GraphArrays("b", places_ids, places, NONE, ids, objects, np.array(classes, dtype=np.int64), NONE, NONE)


def answer(verifier, graph, place, frame, ages=None, drift=None):
    fragment = fragment_of_arrays(written_in(frame, graph), place, verifier.config, ages, drift)
    found = verifier.verify(fragment)
    best = int(found.rows[0])
    return fragment, placed(verifier.mapped, fragment, found, [best])[best]


def test_what_is_seen_as_it_is_mapped_gives_the_pose_to_a_centimetre(homes):
    maps, _, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    for seed, place in enumerate((3, 40, 90)):
        frame = any_frame(np.random.default_rng(seed))
        # The robot stands beside the map's places, and higher.
        graph = replace(maps[0], place_positions=maps[0].place_positions + np.array([0.3, -0.2, 0.1]))
        fragment, found = answer(verifier, graph, place, frame)
        np.testing.assert_allclose(found.of(fragment.origin), graph.place_positions[place], atol=0.02)
        assert np.cos(found.yaw + frame.yaw) == pytest.approx(1.0, abs=1e-5)
        # A point elsewhere in the frame lands where it is, too; the transform is that of the origin.
        np.testing.assert_allclose(found.of(frame.of(np.array([2.0, 5.0, 1.0]))), [2.0, 5.0, 1.0], atol=0.15)
        np.testing.assert_allclose(found.of(np.zeros(3)), found.translation)


def test_objects_that_were_moved_do_not_drag_the_pose(homes):
    maps, _, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    moved = maps[0].object_positions.copy()
    moved[::4, :2] += 0.9  # a quarter, all into one direction
    frame = any_frame(np.random.default_rng(3))
    fragment, found = answer(verifier, replace(maps[0], object_positions=moved), 40, frame)
    off = np.linalg.norm(found.of(fragment.origin) - maps[0].place_positions[40])
    assert off < 0.1, "a mean would be off by more than 0.2 m"


def test_the_newest_surroundings_count_most_where_the_frame_drifts(homes):
    maps, _, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    place = 40
    off = maps[0].object_positions - maps[0].place_positions[place]
    old = np.linalg.norm(off[:, :2], axis=1) > 4.0
    written = maps[0].object_positions + np.where(old[:, None], np.array([0.4, 0.0, 0.0]), 0.0)
    graph, frame = replace(maps[0], object_positions=written), any_frame(np.random.default_rng(1))
    errors = []
    for ages, drift in ((np.where(old, 30.0, 0.0), 1.0), (np.zeros(len(old)), 0.0)):
        fragment, found = answer(verifier, graph, place, frame, ages, drift)
        errors.append(np.linalg.norm(found.of(fragment.origin) - maps[0].place_positions[place]))
    assert errors[0] < 0.12
    assert errors[0] < errors[1]


def test_covariances_mean_what_they_say(homes):
    """Second runs with a detector's noise, walked with drift and without."""
    maps, again, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    for drift in (0.0, 1.0):
        errors = PoseErrors()
        for seed in range(12):
            path = walk(again[seed % 2], WalkConfig(distance_m=20.0, drift=drift), np.random.default_rng(seed))
            frame = any_frame(np.random.default_rng(seed))
            for step in (path.steps // 2, path.steps - 1):
                part, place = path.part(step)
                fragment, found = answer(verifier, part, place, frame, path.ages(step), path.drift(step))
                truth = path.positions[path.places[step]]
                if found.building != seed % 2 or np.linalg.norm(found.of(fragment.origin) - truth) > 4.0:
                    continue
                errors.add(
                    found.of(fragment.origin) - truth,
                    found.yaw + frame.yaw + path.frame(step).yaw,
                    found.covariance,
                )
        figures = errors.figures()
        assert errors.count >= 18
        assert 0.4 < figures["nees"] < 1.8, (drift, figures)
        assert figures["coverage"] > 0.85, (drift, figures)
        assert figures["position_error_m"] < 0.15


def test_what_may_fit_by_chance_says_little_however_well_it_fits():
    """Two objects as they are mapped, among places where nothing tells one heading from another; and then six."""
    places = [[x, y, 0.0] for x in np.arange(-3, 3.5, 1.0) for y in np.arange(-3, 3.5, 1.0)]
    around = [[2.0, 0.0, 0], [0.0, 2.5, 0], [-1.5, -2.0, 0], [1.0, 1.5, 0], [-2.5, 0.5, 0], [0.5, -1.5, 0]]
    spread = []
    for n in (2, 6):
        mapped = building(around[:n], list(range(1, n + 1)), places)
        verifier = layout_verifier((mapped,), 7)
        fragment = fragment_of_arrays(mapped, 24, CONFIG)
        found = verifier.verify(fragment)
        covariance = placed(verifier.mapped, fragment, found, [int(found.rows[0])])[int(found.rows[0])].covariance
        spread.append(np.sqrt(np.diag(covariance))[[0, 1, 3]])
    assert (spread[0] > 0.25).all(), "a metre and thirty degrees off are to be reckoned with"
    assert (spread[1] < 0.1).all()


def test_a_heading_that_cannot_be_told_has_a_wide_variance():
    """Two like objects on either side: half a turn explains as much."""
    places = [[x, y, 0.0] for x in np.arange(-3, 3.5, 1.0) for y in np.arange(-3, 3.5, 1.0)]
    mapped = building([[2.0, 0, 0], [-2.0, 0, 0]], [1, 1], places)
    verifier = layout_verifier((mapped,), 3)
    fragment = fragment_of_arrays(mapped, 24, CONFIG)
    found = verifier.verify(fragment)
    both = placed(verifier.mapped, fragment, found, found.rows.tolist())[int(found.rows[0])]
    assert both.covariance[3, 3] > 1.0
    three = building([[2.0, 0, 0], [-2.0, 0, 0], [0.0, 2.0, 0]], [1, 1, 2], places)
    fragment = fragment_of_arrays(three, 24, CONFIG)
    verifier = layout_verifier((three,), 3)
    found = verifier.verify(fragment)
    one = placed(verifier.mapped, fragment, found, found.rows.tolist())[int(found.rows[0])]
    assert one.covariance[3, 3] < 0.5 * both.covariance[3, 3]


def test_a_lever_carries_the_turns_uncertainty():
    mapped = building([[2.0, 0, 0], [-2.0, 1.0, 0], [0.0, 2.0, 0]], [1, 2, 2], [[0, 0, 0], [1.0, 0, 0]])
    verifier = layout_verifier((mapped,), 3)
    fragment = fragment_of_arrays(mapped, 0, CONFIG)
    found = verifier.verify(fragment)
    best = placed(verifier.mapped, fragment, found, [0])[0]
    far = best.covariance_at(np.array([100.0, 0.0, 0.0]))
    turn = best.covariance[3, 3]
    assert far[3, 3] == turn
    assert far[0, 0] + far[1, 1] == pytest.approx(1e4 * turn, rel=0.2)


def test_a_place_near_an_answer_has_its_pose_though_it_was_not_tested(homes):
    """Else a match on a place that the test passed over would move no robot: no pose, no transform."""
    maps, _, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    fragment = fragment_of_arrays(written_in(any_frame(np.random.default_rng(0)), maps[0]), 40, verifier.config)
    found = verifier.verify(fragment)
    best, at = int(found.rows[0]), verifier.mapped.positions
    off = np.linalg.norm(at - at[best], axis=1)
    other = verifier.mapped.building != verifier.mapped.building[best]
    untested = [row for row in np.argsort(off).tolist() if row not in set(found.rows.tolist()) and not other[row]]
    near, far = untested[0], untested[-1]
    assert off[near] < 2.0
    assert off[far] > 6.0
    poses = placed(verifier.mapped, fragment, found, [best, near, far])
    np.testing.assert_array_equal(poses[near].position, poses[best].position)
    assert far not in poses or np.linalg.norm(poses[far].position - at[far]) <= 4.0


def test_a_query_leaves_nothing_behind_in_what_robots_share(homes):
    """Robots of one process ask one map at the same time: what a query kept there would be another one's, too."""
    maps, _, space = homes
    verifier = layout_verifier(tuple(maps), len(space))

    def held(thing, known=None):
        known = {} if known is None else known
        if id(thing) not in known and type(thing).__module__.startswith("semloc_core.") and hasattr(thing, "__dict__"):
            known[id(thing)] = {name: id(value) for name, value in vars(thing).items()}
            for value in vars(thing).values():
                held(value, known)
        return known

    before = held(verifier)
    assert len(before) >= 6, "the map, its rooms, the objects around its places, the scan, the votes"
    answer(verifier, maps[0], 40, any_frame(np.random.default_rng(0)))
    assert held(verifier) == before
