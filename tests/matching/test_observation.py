"""The likelihood of what has been seen: it knows how far the robot has looked."""

import random

import msgspec
import numpy as np
import pytest
from scipy.stats import poisson
from small_building import SPACE, building_update

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.matching.observation import (
    RING_CENTRES_M,
    ObservationConfig,
    ObservationModel,
    Surroundings,
    ring_shares,
    surroundings,
)

R, C = len(RING_CENTRES_M), len(SPACE)


def corridor(**options) -> SceneGraph:
    graph = SceneGraph()
    graph.apply(building_update(**options))
    return graph


def test_rings_share_out_each_object_and_none_is_lost_far_away():
    shares = ring_shares(np.array([0.0, 1.5, 4.0, 29.9, 500.0]))
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
    assert shares[1].argmax() == 1
    assert shares[4].argmax() == R - 1


def test_surroundings_count_places_and_objects_by_geodesic_distance():
    graph = corridor()
    around = surroundings(graph, SPACE, ["p5", "p0"])
    expected = np.zeros((C, R))
    for key, thing in graph.objects.items():
        (parent,) = graph.parents[key]
        expected[SPACE.index(thing.class_)] += ring_shares(np.array([abs(int(parent[1:]) - 5.0)]))[0]
    np.testing.assert_allclose(around.objects[0], expected, atol=1e-5)
    assert around.places.sum(axis=1) == pytest.approx([30.0, 30.0])
    assert around.objects[1].sum() == pytest.approx(20.0, abs=1e-4)


def test_the_order_in_which_nodes_came_does_not_show_in_the_last_bit():
    update, rng = building_update(length=60, objects=40, spacing=0.37), random.Random(0)
    expected = surroundings(SceneGraph.from_update(update), SPACE, ["p5", "p31"])
    for _ in range(5):
        shuffled = msgspec.structs.replace(
            update,
            places=rng.sample(update.places, len(update.places)),
            objects=rng.sample(update.objects, len(update.objects)),
            edges=rng.sample(update.edges, len(update.edges)),
        )
        found = surroundings(SceneGraph.from_update(shuffled), SPACE, ["p5", "p31"])
        assert found.places.tobytes() == expected.places.tobytes()
        assert found.objects.tobytes() == expected.objects.tobytes()


def test_an_unknown_class_says_nothing():
    graph = corridor()
    fewer = type(SPACE)("fewer", ("plant",))
    plants = sum(thing.class_ == "plant" for thing in graph.objects.values())
    assert surroundings(graph, fewer, ["p5"]).objects.sum() == pytest.approx(plants, abs=1e-4)


def test_log_likelihood_differs_between_places_as_poisson_counts_do():
    rng = np.random.default_rng(0)
    mapped = Surroundings(rng.integers(0, 4, (6, C, R)).astype(np.float32), np.full((6, R), 9.0, np.float32))
    seen = Surroundings(rng.integers(0, 3, (2, C, R)).astype(np.float32), rng.uniform(1, 9, (2, R)).astype(np.float32))
    config = ObservationConfig(shape=0.0)
    found = ObservationModel(mapped, config).log_likelihood(seen)
    total = mapped.objects.sum(axis=(0, 2))
    invented = config.invented * (total / total.sum() + 0.1 / C) / 1.1
    rate = config.detected * mapped.objects / 10.0 + invented[None, :, None]
    exact = np.array(
        [
            [poisson.logpmf(q, e[None, :] * rate[m]).sum() for m in range(6)]
            for q, e in zip(seen.objects, seen.places, strict=True)
        ]
    )
    np.testing.assert_allclose(found - found[:, :1], exact - exact[:, :1], rtol=1e-4, atol=1e-3)


def test_what_was_not_seen_speaks_only_where_it_was_looked_for():
    objects = np.zeros((2, C, R), dtype=np.float32)
    objects[0, 0, 4] = 3.0  # place 0 has three chairs about 8 m away, place 1 has none
    model = ObservationModel(Surroundings(objects, np.full((2, R), 5.0, np.float32)))
    nothing = np.zeros((1, C, R), dtype=np.float32)
    near, far = np.zeros((1, R), np.float32), np.zeros((1, R), np.float32)
    near[0, :3], far[0, :5] = 4.0, 4.0
    only_near = model.log_likelihood(Surroundings(nothing, near))[0]
    as_far = model.log_likelihood(Surroundings(nothing, far))[0]
    assert only_near[0] == pytest.approx(only_near[1])
    assert as_far[0] < as_far[1] - 0.5


def test_a_place_with_less_room_than_was_found_is_unlikely():
    places = np.stack([np.full(R, 2.0), np.full(R, 20.0)]).astype(np.float32)
    seen = Surroundings(np.zeros((1, C, R), np.float32), np.full((1, R), 15.0, np.float32))
    found = ObservationModel(Surroundings(np.zeros((2, C, R), np.float32), places)).log_likelihood(seen)[0]
    assert found[0] < found[1] - 1.0
