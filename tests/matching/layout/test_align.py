"""Alignment against poses that are known and likelihoods that can be written down."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from semloc_core.graph import Labelspace, SceneGraph
from semloc_core.graph.arrays import GraphArrays
from semloc_core.matching.layout import (
    LayoutConfig,
    LayoutPart,
    LayoutVerifier,
    MappedLayout,
    fragment_of_arrays,
    fragment_of_graph,
)
from semloc_core.matching.layout.confidence import perfect
from semloc_core.matching.layout.evidence import evidence_at
from semloc_core.matching.layout.pose.align import FARTHER, NARROWER, Aligned, align
from semloc_core.matching.layout.pose.heading_vote import HEADINGS, MORE, TIED, best_poses, heading_scores
from semloc_core.wire import Object, Place

CONFIG = LayoutConfig()
NONE = np.zeros((2, 0), dtype=np.int64)


def building(objects, classes, places):
    objects, places = np.array(objects, dtype=float).reshape(-1, 3), np.array(places, dtype=float)
    return GraphArrays(
        "b",
        tuple(f"p{i}" for i in range(len(places))),
        places,
        NONE,
        tuple(f"o{i}" for i in range(len(objects))),
        objects,
        np.array(classes, dtype=np.int64),
        NONE,
        NONE,
    )


def layout(graph, n_classes=3):
    return MappedLayout([LayoutPart(graph, np.arange(graph.n_places), n_classes)], n_classes, CONFIG)


def turn(graph, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return replace(
        graph,
        place_positions=graph.place_positions @ matrix + shift,
        object_positions=graph.object_positions @ matrix + shift,
    )


def test_a_known_turn_and_shift_are_found(homes):
    mapped = homes[0][0]
    place = mapped.n_places // 2
    moved = turn(mapped, 0.7, np.array([30.0, -8.0, 0.4]))
    moved = replace(moved, place_positions=moved.place_positions + np.array([0.3, -0.2, 0.0]))  # beside the map's place
    fitted = align(
        layout(mapped, len(homes[2])), fragment_of_arrays(moved, place, CONFIG), np.array([place]), np.array([-0.6])
    )
    assert fitted.heading[0] == pytest.approx(-0.7, abs=0.01)
    c, s = np.cos(-0.7), np.sin(-0.7)
    np.testing.assert_allclose(fitted.shift[0], [c * 0.3 + s * 0.2, s * 0.3 - c * 0.2], atol=0.08)
    assert (fitted.explained >= 0).all()
    assert fitted.score[0] > 0.6 * fitted.explained.sum()


def test_one_objects_share_is_the_likelihood_ratio_written_down():
    """Nothing moves: object and map agree, so that the density is the Gaussian's at its middle."""
    graph = building([[3.0, 0, 0]], [1], [[0, 0, 0], [1, 0, 0]])
    mapped = layout(graph)
    fitted = align(mapped, fragment_of_arrays(graph, 0, CONFIG), np.array([0]), np.array([0.0]))
    peak = CONFIG.detected / (2 * np.pi * CONFIG.spread_m**2)
    assert fitted.explained[0, 0] == pytest.approx(np.log1p(peak / mapped.invented[1]), rel=1e-6)
    assert fitted.walls[0] == 0


def test_an_object_that_may_be_several_things_is_explained_by_each_as_likely_as_it_is():
    """The mixture's likelihood ratio written down, where the map has a bed and the robot says: a couch, or a bed."""
    space = Labelspace("three", ("chair", "couch", "bed"))
    graph = building([[3.0, 0, 0], [0.0, 5.0, 0.0]], [2, 1], [[0, 0, 0], [1, 0, 0]])
    mapped = layout(graph)
    peak = CONFIG.detected / (2 * np.pi * CONFIG.spread_m**2)

    def fitted(class_, labels):
        thing = Object("o", class_, (3.0, 0.0, 0.0), None, labels)
        live = SceneGraph.of([Place("p", (0.0, 0.0, 0.0))], [thing])
        return fragment_of_graph(live, space, "p", CONFIG)

    def explained(class_, labels):
        return align(mapped, fitted(class_, labels), np.array([0]), np.array([0.0])).explained[0, 0]

    assert explained("couch", None) == 0
    frequency = mapped.invented[2] / CONFIG.invented
    for labels, weight in (
        ({"couch": 0.6, "bed": 0.4}, 0.4),
        ({"couch": 0.6, "bed": 0.3}, 0.3 + 0.1 * frequency),
        ({"couch": 0.6, "bed": 0.3, "lamp": 0.1}, 0.3),
    ):
        assert explained("couch", labels) == pytest.approx(np.log1p(weight * peak / mapped.invented[2]), rel=1e-6)
    whole, plain = fitted("bed", {"bed": 1.0}), fitted("bed", None)
    assert explained("bed", {"bed": 1.0}) == explained("bed", None) > explained("bed", {"bed": 0.9, "couch": 0.1})
    assert perfect(whole, mapped) == perfect(plain, mapped) > perfect(fitted("bed", {"bed": 0.5}), mapped)
    assert fitted("couch", {"couch": 0.6}).without(1).likely.shape == (0, 4)


def test_evidence_names_what_explains_an_object_that_may_be_several_things(homes):
    maps, _, space = homes
    verifier = LayoutVerifier([maps[0]], [np.arange(maps[0].n_places)], len(space))
    graph, place = maps[0].to_scene_graph(space), maps[0].place_ids[7]
    plain = fragment_of_graph(graph, space, place, verifier.config)
    key, other = plain.object_ids[0], int(plain.classes[0] == 0)
    names = space.classes[other], space.classes[plain.classes[0]]
    graph.amend(objects=[Object(key, names[0], graph.objects[key].position, None, {names[0]: 0.5, names[1]: 0.5})])
    found = evidence_at(verifier, fragment_of_graph(graph, space, place, verifier.config), 7)
    assert found.mapped[found.fragment.object_ids.index(key)] == key


def test_an_object_that_should_have_been_seen_is_missed_and_one_elsewhere_is_not():
    places = [[x, y, 0.0] for x in range(-5, 6) for y in range(-2, 3)]
    seen = building([[3.0, 0, 0]], [1], places)
    for extra, missed in (([-3.0, 0, 0], 1), ([-3.0, 9, 0], 0), ([-3.0, 0, 3.0], 0)):
        mapped = layout(building([[3.0, 0, 0], extra], [1, 2], places))
        fitted = align(mapped, fragment_of_arrays(seen, 27, CONFIG), np.array([27]), np.array([0.0]))
        assert fitted.missing[0] == pytest.approx(CONFIG.detected * CONFIG.looked * (1 + missed))


def test_an_object_that_is_likely_gone_counts_for_less_found_or_missed():
    """Weights are of merged maps: the probability that an object is still where the map has it."""
    places = [[x, y, 0.0] for x in range(-5, 6) for y in range(-2, 3)]
    both = building([[3.0, 0, 0], [-3.0, 0, 0]], [1, 2], places)
    one = fragment_of_arrays(building([[3.0, 0, 0]], [1], places), 27, CONFIG)
    every = np.arange(both.n_places)
    scores = {}
    for weights in ((1.0, 1.0), (1.0, 0.5), (1.0, 0.0), (0.5, 1.0), (0.0, 1.0)):
        mapped = MappedLayout([LayoutPart(both, every, 3, np.array(weights))], 3, CONFIG)
        fitted = align(mapped, one, np.array([27]), np.array([0.0]))
        assert fitted.missing[0] == pytest.approx(CONFIG.detected * CONFIG.looked * sum(weights))
        scores[weights] = fitted.score[0]
        votes = heading_scores(mapped, one, np.array([27]))
        assert (votes.max() > 0) == (weights[0] > 0)
    assert scores[1.0, 0.0] > scores[1.0, 0.5] > scores[1.0, 1.0] > scores[0.5, 1.0] > scores[0.0, 1.0]


def test_room_that_the_map_does_not_have_costs():
    corridor = [[x, 0.0, 0.0] for x in range(20)]
    hall = [[x, y, 0.0] for x in range(20) for y in range(-4, 5)]
    mapped = layout(building([[3.0, 0, 0]], [1], corridor))
    seen = fragment_of_arrays(building([[3.0, 0, 0]], [1], hall), 4, CONFIG)
    inside = fragment_of_arrays(building([[3.0, 0, 0]], [1], corridor), 0, CONFIG)
    assert align(mapped, seen, np.array([0]), np.array([0.0])).walls[0] > 5
    assert align(mapped, inside, np.array([0]), np.array([0.0])).walls[0] == 0


@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5, -2.0])
def test_objects_vote_for_the_heading_that_the_robot_has(homes, angle):
    mapped = homes[0][0]
    place = 7
    moved = turn(mapped, angle, np.zeros(3))
    scores = heading_scores(layout(mapped, len(homes[2])), fragment_of_arrays(moved, place, CONFIG), np.array([place]))
    off = (scores[0].argmax() * 2 * np.pi / HEADINGS + angle) % (2 * np.pi)
    assert min(off, 2 * np.pi - off) <= np.pi / HEADINGS + 1e-6


def _row_of(positions):
    """A map with a place at each position, metres."""
    return layout(building([[0.0, 0, 0]], [1], positions))


def test_poses_beside_one_another_are_one():
    scores = np.zeros((3, HEADINGS), dtype=np.float32)
    scores[0, 3], scores[1, 4], scores[2, 3], scores[0, 15] = 3.0, 2.0, 1.0, 0.5
    mapped, rows = _row_of([[0.0, 0, 0], [0.5, 0, 0], [5.0, 0, 0]]), np.arange(3)
    place, heading = best_poses(mapped, rows, scores, 10, 1.0)
    assert place.tolist() == [0, 2, 0]
    assert heading.tolist() == [3, 3, 15]
    scores[0, 3] = 8.0
    assert len(best_poses(mapped, rows, scores, 1, 1.0)[0]) == 1


def test_poses_that_tie_are_all_kept_up_to_a_bound():
    """A tower of flats: which of them is tried must not be left to their order."""
    scores, mapped = np.zeros((100, HEADINGS), dtype=np.float32), _row_of(10.0 * np.arange(300.0).reshape(100, 3))
    rows = np.arange(100)
    scores[:, 3] = 7.0
    scores[6:8, 3] = 7.0 + TIED / 2
    place, _ = best_poses(mapped, rows, scores, 5, 1.0)
    assert place.tolist() == [6, 7, *range(6), *range(8, 5 * MORE)]
    scores[6:8, 3] = 7.1 + TIED
    assert best_poses(mapped, rows, scores, 5, 1.0)[0].tolist() == [6, 7, 0, 1, 2]


def test_of_poses_that_objects_speak_for_alike_those_with_room_for_the_robot_are_aligned():
    """Two rooms, furnished alike; only the second has the corridor that the robot has walked."""
    objects = np.array([[1.0, 1.0, 0], [-1.0, 2.0, 0], [2.0, -1.5, 0]])
    corridor = np.array([[x, 0.0, 0] for x in range(-8, 9)])
    there = np.array([60.0, 0, 0])
    places = np.concatenate([[[0.0, 0, 0]], corridor + there])
    graph = building(np.concatenate([objects, objects + there]), [0, 1, 2, 0, 1, 2], places)
    verifier = LayoutVerifier([graph], [np.arange(len(places))], 3, msgspec.structs.replace(CONFIG, fine=1))
    seen = fragment_of_arrays(building(objects, [0, 1, 2], corridor), 8, CONFIG)
    middle = 1 + 8
    rows, heading = verifier.poses(seen, np.array([0, middle]))
    assert rows.tolist()[0] == middle
    assert heading[0] == pytest.approx(0.0)
    # By votes alone the first is as good, and comes first.
    alone = LayoutVerifier([graph], [np.arange(len(places))], 3, msgspec.structs.replace(CONFIG, fine=1, wide=1))
    with_less = replace(seen, places=seen.places[:0])
    assert alone.poses(with_less, np.array([0, middle]))[0].tolist()[0] == 0


def _room(noise_m: float) -> Aligned:
    """Eight objects of eight classes around a robot, as mapped but for errors, fitted at the true pose."""
    rng = np.random.default_rng(3)
    at = rng.uniform(-4.0, 4.0, (8, 3)) * [1.0, 1.0, 0.1]
    graph = building(at, np.arange(8), [[0, 0, 0], [1, 0, 0]])
    seen = replace(graph, object_positions=at + noise_m * rng.standard_normal((8, 3)) * [1.0, 1.0, 0.0])
    return align(layout(graph, 8), fragment_of_arrays(seen, 0, CONFIG), np.array([0]), np.array([0.0]))


def test_the_more_exact_a_detector_is_the_more_its_objects_say():
    """Written down: eight objects with no error, under a spread an eighth of the widest, less three numbers' worth."""
    peak = 8 * CONFIG.detected / (2 * np.pi * CONFIG.spread_m**2) / (CONFIG.invented * (1 / 8 + 0.1 / 8) / 1.1)
    odds = peak / 8 * ((1 - FARTHER) / NARROWER[-1] ** 2 + FARTHER)
    assert _room(0.0).explained.sum() == pytest.approx(8 * np.log1p(odds) + 3 * np.log(NARROWER[-1]), rel=1e-6)
    explained = [float(_room(noise).explained.sum()) for noise in (0.0, 0.1, 0.3, 0.6)]
    assert explained == sorted(explained, reverse=True)
    assert explained[0] > explained[-1] + 8.0


def test_one_pair_of_objects_does_not_buy_an_exact_pose():
    """Any two objects of a map that are about as far apart can be laid on two seen ones: that is no evidence."""
    graph = building([[2.0, 0, 0], [0.0, 2.0, 0]], [0, 1], [[0, 0, 0], [1, 0, 0]])
    fitted = align(layout(graph), fragment_of_arrays(graph, 0, CONFIG), np.array([0]), np.array([0.0]))
    wide = np.log1p(CONFIG.detected / (2 * np.pi * CONFIG.spread_m**2) / layout(graph).invented[:2]).sum()
    exact = 2 * np.log((1 - FARTHER) / NARROWER[-1] ** 2) + 3 * np.log(NARROWER[-1])
    assert wide <= fitted.explained.sum() < wide + exact + 0.5


def test_an_object_without_a_name_may_be_anything_and_proposes_nothing():
    """Its odds are those of a detector that names nothing: the map's density over that of all that is invented."""
    graph = building([[3.0, 0, 0], [0, 2.0, 0]], [1, 0], [[0, 0, 0], [1, 0, 0]])
    mapped, space = layout(graph), Labelspace("s", ("chair", "couch", "bed"))

    def fitted(class_):
        seen = SceneGraph.of([Place("p0", (0.0,) * 3)], [Object("o", class_, (3.0, 0.0, 0.0))], [("p0", "o")])
        fragment = fragment_of_graph(seen, space, "p0", CONFIG)
        return fragment, align(mapped, fragment, np.array([0]), np.array([0.0])) if len(fragment.classes) else None

    fragment, named = fitted("unknown")
    there = CONFIG.detected / (2 * np.pi * CONFIG.spread_m**2)
    assert named.explained[0] == pytest.approx(np.log1p(there / CONFIG.invented), rel=1e-6)
    assert perfect(fragment, mapped) == pytest.approx(named.explained.sum())
    assert fragment.classes.tolist() == [-1]
    assert not len(fragment.sure().classes)
    assert fitted("zeppelin")[1] is None, "a name that the map lacks is of none of its classes"
    assert fitted("couch")[1].explained[0] > named.explained[0]


def test_what_each_object_may_be_gives_the_same_where_it_is_one_class_for_sure(homes):
    mapped = layout(homes[0][0], len(homes[2]))
    fragment = fragment_of_arrays(homes[1][0], 5, CONFIG)
    one = np.eye(len(homes[2]) + 1)[fragment.classes]
    rows = np.arange(0, homes[0][0].n_places, 9)
    heading = np.zeros(len(rows))
    found = [align(mapped, each, rows, heading) for each in (fragment, replace(fragment, likely=one))]
    np.testing.assert_allclose(found[1].explained, found[0].explained, atol=1e-9)
    np.testing.assert_allclose(found[1].heading, found[0].heading, atol=1e-9)
    votes = [heading_scores(mapped, each, rows) for each in (fragment, replace(fragment, likely=one))]
    np.testing.assert_allclose(votes[1], votes[0], rtol=1e-5)
