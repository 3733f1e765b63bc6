"""The whole verification: right in any frame, the same in any order, silent where there is nothing to go by."""

import dataclasses

import numpy as np
import pytest

from semloc_core.evaluate.verified_answers import any_frame, layout_verifier, written_in
from semloc_core.matching.layout import LayoutVerifier, fragment_of_arrays
from semloc_core.matching.layout.answers import FEATURES, shipped_calibration
from semloc_core.matching.layout.confidence import confidence, features, masses


@pytest.fixture(scope="module")
def verifier(homes) -> LayoutVerifier:
    return layout_verifier(tuple(homes[0]), len(homes[2]))


def ask(verifier, graph, place, only=None):
    fragment = fragment_of_arrays(graph, place, verifier.config)
    return fragment, verifier.verify(fragment, only=only)


def test_a_second_run_finds_itself_whatever_its_frame(homes, verifier):
    again = homes[1]
    right = []
    for building, graph in enumerate(again):
        frame = written_in(any_frame(np.random.default_rng(building)), graph)
        for place in range(0, graph.n_places, 29):
            found = ask(verifier, frame, place)[1]
            at = verifier.mapped.positions[found.rows[0]]
            near = np.linalg.norm(at - graph.place_positions[place]) <= 4.0
            right.append(near and verifier.mapped.building[found.rows[0]] == building)
    assert len(right) > 10
    assert np.mean(right) > 0.9


def test_places_are_listed_once_by_falling_score_and_only_where_the_robot_can_be(homes, verifier):
    only = verifier.mapped.building == 1
    found = ask(verifier, homes[1][0], 5, only)[1]
    assert len(set(found.rows.tolist())) == len(found.rows) > 5
    assert (np.diff(found.score) <= 0).all()
    assert only[found.rows].all()
    np.testing.assert_allclose(found.score, found.explained.sum(axis=1) - found.missing - found.walls, atol=1e-5)


def test_the_answer_does_not_hang_on_the_order_of_nodes(homes, verifier):
    graph = homes[1][0]
    rng = np.random.default_rng(0)
    places, objects = rng.permutation(graph.n_places), rng.permutation(graph.n_objects)
    none = np.zeros((2, 0), dtype=np.int64)
    shuffled = dataclasses.replace(
        graph,
        place_ids=tuple(graph.place_ids[i] for i in places),
        place_positions=graph.place_positions[places],
        place_edges=none,
        object_ids=tuple(graph.object_ids[i] for i in objects),
        object_positions=graph.object_positions[objects],
        object_classes=graph.object_classes[objects],
        object_parents=none,
        sightings=none,
    )
    for place in (0, 40):
        one, other = ask(verifier, graph, place)[1], ask(verifier, shuffled, int(np.flatnonzero(places == place)[0]))[1]
        np.testing.assert_array_equal(one.rows, other.rows)
        np.testing.assert_allclose(one.score, other.score, atol=1e-5)


def test_nothing_seen_and_nothing_mapped_are_no_answer(homes, verifier):
    bare = homes[1][0].with_objects(np.zeros(homes[1][0].n_objects, dtype=np.bool_))
    assert ask(verifier, bare, 0)[1] is None
    empty = LayoutVerifier([bare], [np.arange(bare.n_places)], len(homes[2]))
    assert ask(empty, homes[1][0], 0)[1] is None


def test_a_twin_takes_half_the_belief(homes, verifier):
    twins = layout_verifier((homes[0][0], homes[0][0]), len(homes[2]))
    for place in (3, 30):
        fragment, found = ask(twins, homes[1][0], place)
        sure = confidence(found, fragment, twins.mapped)
        assert sure.probability[0] <= 0.5 + 1e-9
        other = twins.mapped.building[found.rows] != twins.mapped.building[found.rows[0]]
        assert sure.probability[other].max() == pytest.approx(sure.probability[0], abs=0.05)
        assert masses(found, twins.mapped)[0] <= 0.5 + 1e-6


def test_probabilities_are_probabilities_and_the_best_has_the_most(homes, verifier):
    for graph in homes[1]:
        for place in range(0, graph.n_places, 40):
            fragment, found = ask(verifier, graph, place)
            sure = confidence(found, fragment, verifier.mapped)
            assert sure.probability.shape == found.rows.shape
            assert ((sure.probability >= 0) & (sure.probability <= sure.probability[0] + 1e-12)).all()
            assert sure.probability[0] <= sure.in_map <= 1
            assert np.isfinite(features(found, fragment, verifier.mapped)).all()


def test_the_shipped_calibration_is_of_these_features():
    calibration = shipped_calibration()
    n = len(FEATURES)
    assert calibration.features == FEATURES
    assert len(calibration.mean) == len(calibration.deviation) == n
    terms = calibration.terms(np.array([calibration.mean]))
    assert terms.shape == (1, len(calibration.right)) == (1, 1 + n + n * (n + 1) // 2)
    assert terms[0, 0] == 1
    assert not terms[0, 1:].any()
