"""Places proposed by pairs of objects: the right one whatever the frame, the crowd, and the order of the map."""

from __future__ import annotations

import numpy as np
import pytest

from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.pair_votes import REACH_M, ObjectPairs, PairVotes

CLASSES, MOST = 12, 400


def building(seed: int, n: int = 25) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places on a grid of a metre, objects and their classes, in a building of 10 m by 10 m."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [1.0]), axis=-1).reshape(-1, 3)
    objects = np.concatenate([rng.uniform(0, 10, (n, 2)), rng.uniform(0, 1.5, (n, 1))], axis=1)
    return grid, objects, rng.integers(0, CLASSES, n)


def votes(buildings: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> PairVotes:
    return PairVotes(
        [ObjectPairs.of(objects, classes, CLASSES) for _, objects, classes in buildings],
        np.concatenate([objects for _, objects, _ in buildings]),
        [len(objects) for _, objects, _ in buildings],
        np.concatenate([places for places, _, _ in buildings]),
        np.repeat(np.arange(len(buildings)), [len(places) for places, _, _ in buildings]),
        CLASSES,
    )


def seen(objects: np.ndarray, classes: np.ndarray, at: np.ndarray, yaw: float) -> Fragment:
    """Objects as a robot has them whose frame is turned by ``yaw`` into the building's."""
    off = objects - at
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.stack([c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0], off[:, 2]], axis=1)
    order = np.argsort(np.linalg.norm(turned, axis=1))
    none = np.zeros(len(order))
    return Fragment(turned[order], classes[order], tuple(map(str, order)), np.zeros((1, 3)), np.zeros(3), none)


@pytest.mark.parametrize("yaw", [0.0, 0.13, np.pi / 2, np.pi, -2.2])
def test_the_right_place_is_the_first_among_many_buildings_whatever_the_frame(yaw: float) -> None:
    many = [building(seed) for seed in range(40)]
    found, first = votes(many), 0
    for number in (0, 17, 39):
        places, objects, classes = many[number]
        at = np.array([4.3, 5.6, 1.2])
        near = np.argsort(np.linalg.norm(objects - at, axis=1))[:6]
        noise = np.random.default_rng(number).normal(0.0, 0.1, (6, 3))
        rows = found.rows(seen(objects[near] + noise, classes[near], at, yaw), MOST)
        first = number * len(places)
        assert first <= rows[0] < first + len(places)
        assert np.linalg.norm(places[rows[0] - first] - at) < 1.5
        assert len(set(rows.tolist())) == len(rows)


def test_what_has_not_been_seen_speaks_against_nothing() -> None:
    """The right building crowded with other things: a scan of what lies around would expect to see them."""
    many = [building(seed) for seed in range(10)]
    places, objects, classes = many[3]
    at = np.array([4.3, 5.6, 1.2])
    near = np.argsort(np.linalg.norm(objects - at, axis=1))[:6]
    fragment = seen(objects[near], classes[near], at, 1.0)
    _, more, kinds = building(99, 80)
    many[3] = (places, np.concatenate([objects, more]), np.concatenate([classes, kinds]))
    row = votes(many).rows(fragment, MOST)[0]
    assert 300 <= row < 400
    assert np.linalg.norm(places[row - 300] - at) < 1.5


def test_only_where_the_robot_can_be() -> None:
    many = [building(seed) for seed in range(5)]
    _, objects, classes = many[2]
    fragment = seen(objects[:8], classes[:8], objects[:8].mean(axis=0), 0.4)
    only = np.zeros(500, dtype=bool)
    only[100:200] = True
    rows = votes(many).rows(fragment, MOST, only)
    assert only[rows].all()


def test_the_order_of_buildings_and_of_their_objects_changes_nothing() -> None:
    many = [building(seed) for seed in range(6)]
    _, objects, classes = many[4]
    fragment = seen(objects[5:12], classes[5:12], objects[5:12].mean(axis=0), 0.4)
    best = votes(many).rows(fragment, MOST)[0]
    order = np.random.default_rng(0).permutation(25)
    turned = [(p, o[order], c[order]) for p, o, c in reversed(many)]
    assert votes(turned).rows(fragment, MOST)[0] == best - 400 + 100


def test_pairs_are_those_in_reach_each_once() -> None:
    _, objects, classes = building(1)
    pairs = ObjectPairs.of(objects, classes, CLASSES)
    far = np.linalg.norm((objects[:, None] - objects)[:, :, :2], axis=2)
    wanted = np.triu((far >= 0.8) & (far <= REACH_M), 1)
    assert len(pairs.first) == wanted.sum()
    assert {frozenset(pair) for pair in zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)} == {
        frozenset(pair) for pair in np.argwhere(wanted).tolist()
    }
    assert (classes[pairs.first] <= classes[pairs.second]).all()
    np.testing.assert_allclose(pairs.metres, far[pairs.first, pairs.second])


def test_no_more_places_are_proposed_than_are_wanted() -> None:
    places, objects, classes = building(3)
    found, fragment = (
        votes([(places, objects, classes)]),
        seen(objects[:12], classes[:12], np.array([5.0, 5.0, 1.0]), 0.3),
    )
    assert 10 < len(found.rows(fragment, MOST)) <= 100
    assert 1 <= len(found.rows(fragment, 5)) <= 5
    assert not len(found.rows(fragment, 0))


def test_one_object_or_none_like_it_proposes_nothing() -> None:
    found = votes([building(0)])
    one = seen(np.array([[1.0, 1.0, 1.0]]), np.array([3]), np.zeros(3), 0.0)
    assert not len(found.rows(one, MOST))
    assert not len(
        PairVotes([], np.zeros((0, 3)), [], np.zeros((0, 3)), np.zeros(0, dtype=np.int64), CLASSES).rows(one, MOST)
    )
