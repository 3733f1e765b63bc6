"""The filter over places: a reference in dense matrices, and what a robot does to it."""

import tracemalloc

import numpy as np
import pytest
from killing import Calls
from small_building import SPACE, building_update

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.matching.observation import Surroundings, surroundings
from semloc_core.tracking.place_filter import NEIGHBOUR_M, FilterConfig, PlaceFilter, map_model
from semloc_core.wire import Object, Place, SceneGraphUpdate

LENGTH = 30
NOTHING = np.zeros(2 * LENGTH, dtype=np.float32)


def corridor(seed: int) -> SceneGraph:
    graph = SceneGraph()
    graph.apply(building_update(length=LENGTH, seed=seed))
    return graph


def rows(place: int, building: int = 0) -> int:
    """The row of corridor place ``p<place>``: rows are by id, as texts."""
    return building * LENGTH + sorted(range(LENGTH), key=lambda i: f"p{i}").index(place)


@pytest.fixture(scope="module")
def places():
    """A map of two corridors."""
    return map_model([corridor(0), corridor(1)], SPACE)


def at(place: int, building: int = 0, height: float = 30.0) -> np.ndarray:
    evidence = NOTHING.copy()
    evidence[rows(place, building)] = height
    return evidence


def test_walking_moves_belief_as_far_along_the_edges_and_into_no_other_building(places):
    robot = PlaceFilter(places, FilterConfig(memory=1.0))
    robot.update(at(10), 0.0)
    belief = robot.update(NOTHING, 2.0)
    assert belief.sum() == pytest.approx(1.0, abs=1e-5)
    assert belief[rows(8)] + belief[rows(12)] > 0.5
    assert belief[rows(8)] == pytest.approx(belief[rows(12)])
    assert belief[rows(10)] < 0.1
    assert belief[LENGTH:].sum() < 1e-3


def test_a_dense_bayes_filter_believes_the_same(places):
    """With all memory and steps of whole metres: predict by a matrix over geodesic distances, correct, normalise."""
    config = FilterConfig(memory=1.0)
    number = np.array(sorted(range(LENGTH), key=lambda i: f"p{i}"))
    metres = np.abs(number[:, None] - number).astype(np.float64)
    metres = np.block([[metres, np.full_like(metres, np.inf)], [np.full_like(metres, np.inf), metres]])
    rng = np.random.default_rng(0)
    robot, belief = PlaceFilter(places, config), np.full(2 * LENGTH, 1 / (2 * LENGTH))
    for step in range(6):
        walked = float(rng.integers(1, 4)) if step else 0.0
        evidence = rng.normal(0, 2, 2 * LENGTH).astype(np.float32)
        if step:
            kernel = np.where(
                metres <= NEIGHBOUR_M, np.exp(-0.5 * ((metres - walked) / config.spread_m) ** 2) + 1e-9, 0
            )
            kernel /= kernel.sum(axis=0)
            memory = (1 - config.leak) * kernel @ belief + config.leak / len(belief)
        else:
            memory = belief
        belief = memory * np.exp(evidence - evidence.max())
        belief /= belief.sum()
        np.testing.assert_allclose(robot.update(evidence, walked), belief, rtol=2e-3, atol=1e-6)


def test_asking_again_makes_nobody_surer(places):
    evidence = np.random.default_rng(0).normal(0, 1, 2 * LENGTH).astype(np.float32)
    robot = PlaceFilter(places)
    robot.update(at(3, height=1.0), 0.0)
    once = robot.update(evidence, 1.5).copy()
    for _ in range(50):
        again = robot.update(evidence, 0.0)
    np.testing.assert_allclose(again, once, rtol=1e-4)


def test_many_small_steps_are_believed_about_as_few_large_ones(places):
    """An update rate of ten times as much must not count the same evidence ten times."""
    evidence = np.random.default_rng(1).normal(0, 1.5, 2 * LENGTH).astype(np.float32)
    seldom, often = PlaceFilter(places), PlaceFilter(places)
    for step in range(60):
        often.update(evidence, 0.1 if step else 0.0)
        if step % 10 == 0:
            seldom.update(evidence, 1.0 if step else 0.0)
    assert abs(often.belief.max() - seldom.belief.max()) < 0.1
    assert often.belief.argmax() == seldom.belief.argmax()


def test_a_robot_carried_away_is_found_again(places):
    robot = PlaceFilter(places)
    for place in range(5, 15):
        robot.update(at(place, height=6.0), 1.0)
    assert robot.ranking(1)[0][0] in {rows(p) for p in range(12, 17)}
    for place in range(5, 8):
        robot.update(at(place, building=1, height=6.0), 1.0)
    assert robot.ranking(1)[0][0] >= LENGTH


def test_a_known_building_is_never_left(places):
    only = np.arange(2 * LENGTH) >= LENGTH
    robot = PlaceFilter(places, only=only)
    for place in range(5, 10):
        belief = robot.update(at(place, building=0, height=50.0), 1.0)
        assert belief[:LENGTH].sum() == 0
        assert np.isfinite(belief).all()


def test_answers_are_apart_and_fall_in_probability(places):
    robot = PlaceFilter(places)
    robot.update(np.random.default_rng(0).normal(0, 1, 2 * LENGTH).astype(np.float32), 0.0)
    found, probability = robot.ranking(60)
    assert (np.diff(probability) <= 0).all()
    order = sorted(range(LENGTH), key=lambda i: f"p{i}")
    where = [(row // LENGTH, order[row % LENGTH]) for row in found.tolist()]
    assert all(a[0] != b[0] or abs(a[1] - b[1]) > 4 for i, a in enumerate(where) for b in where[:i])
    near = [rows(p) for p in range(LENGTH) if abs(p - where[0][1]) <= 4]
    mass = robot.belief[np.array(near) + where[0][0] * LENGTH].sum()
    assert probability[0] == pytest.approx(mass, rel=1e-5)


def test_a_jump_of_the_frame_spreads_belief_and_breaks_nothing(places):
    robot = PlaceFilter(places)
    robot.update(at(5), 0.0)
    belief = robot.update(NOTHING, 1e6)
    assert belief.sum() == pytest.approx(1.0, abs=1e-4)
    assert belief.max() < 0.2


def test_what_is_seen_from_a_place_speaks_for_it(places):
    graph = corridor(0)
    hits = 0
    for place in range(0, LENGTH, 3):
        seen = surroundings(graph, SPACE, [f"p{place}"])
        evidence = places.evidence(seen, NOTHING[None], FilterConfig())[0]
        robot = PlaceFilter(places)
        robot.update(evidence, 0.0)
        best = int(robot.ranking(1)[0][0])
        hits += best in {rows(p) for p in range(max(0, place - 4), min(LENGTH, place + 5))}
    assert hits == 10


def test_the_weight_of_similarity_grows_with_what_has_been_seen(places):
    config = FilterConfig()
    seen = surroundings(corridor(0), SPACE, ["p5"])
    little = Surroundings(seen.objects, seen.places / 10)
    similarity = np.random.default_rng(0).uniform(0, 1, (1, 2 * LENGTH)).astype(np.float32)

    def added(view: Surroundings) -> np.ndarray:
        return places.evidence(view, similarity, config) - places.evidence(view, 0 * similarity, config)

    np.testing.assert_allclose(added(seen), 20.0 * 30 / 200 * similarity, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(added(little), 20.0 * 3 / 200 * similarity, rtol=1e-2, atol=1e-3)


def grid(side: int, rng: np.random.Generator) -> SceneGraph:
    """Places a metre apart, an object for every four of them."""
    ids = [[f"{x:03d},{y:03d}" for y in range(side)] for x in range(side)]
    parents = rng.integers(0, side, (side * side // 4, 2))
    graph = SceneGraph()
    graph.apply(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1", stamp_ns=0, frame_id="", seq=0, full=True, query_place=None,
            places=[Place(ids[x][y], (float(x), float(y), 0.0)) for x in range(side) for y in range(side)],
            objects=[
                Object(f"o{k}", SPACE.classes[k % len(SPACE)], (float(x), float(y), 1.0))
                for k, (x, y) in enumerate(parents)
            ],
            edges=[(ids[x][y], ids[x + 1][y]) for x in range(side - 1) for y in range(side)]
            + [(ids[x][y], ids[x][y + 1]) for x in range(side) for y in range(side - 1)]
            + [(ids[x][y], f"o{k}") for k, (x, y) in enumerate(parents)],
        )
    )  # fmt: skip
    return graph


def step_cost(buildings: int, steps: int = 10) -> tuple[float, float]:
    """Of a step in a map of so many buildings of 196 places: calls that it makes, and the most bytes it takes."""
    rng = np.random.default_rng(0)
    model = map_model([grid(14, rng)] * buildings, SPACE)
    robot = PlaceFilter(model)
    r = model.observation.n_rings
    seen = Surroundings(np.ones((1, len(SPACE), r), np.float32), np.ones((1, r), np.float32))
    similarity = rng.uniform(0, 1, (1, model.n_places)).astype(np.float32)

    def step():
        robot.update(model.evidence(seen, similarity, robot.config)[0], 1.0)
        robot.ranking(20)

    made, taken = [], []
    for _ in range(steps):
        calls = Calls(float("inf"), lambda: None)
        calls.begin()
        step()
        made.append(calls.end())
        tracemalloc.start()
        step()
        taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return np.median(made), np.median(taken)


def test_a_step_walks_over_no_places_one_by_one_and_its_cost_grows_no_worse_than_linearly():
    (few, small), (many, large) = step_cost(8), step_cost(26)  # 1,568 and 5,096 places
    assert 0 < many < 1.1 * few
    assert many < 1_000
    assert large < 1.5 * (26 / 8) * small


def test_belief_is_carried_over_to_a_map_of_other_buildings():
    """Rows of what both maps have; what the new one has besides is where a robot carried away could be, and no more."""
    graphs = {name: corridor(seed) for seed, name in enumerate("abc")}
    before, after = (map_model([graphs[name] for name in names], SPACE) for names in ("ab", "bc"))
    config = FilterConfig(memory=1.0)
    robot = PlaceFilter(before, config)
    for step in range(4):
        robot.update(at(10 + step, building=1, height=8.0), float(step > 0))
    same_rows = np.concatenate([np.arange(LENGTH, 2 * LENGTH), np.full(LENGTH, -1)])
    moved = PlaceFilter(after, config)
    moved.carry_over(robot, same_rows)
    np.testing.assert_allclose(moved.belief[:LENGTH], robot.belief[LENGTH:], rtol=1e-4)
    assert moved.belief[LENGTH:].max() == 0
    next_belief, stayed = moved.update(NOTHING, 1.0), robot.update(NOTHING, 1.0)
    np.testing.assert_allclose(next_belief[:LENGTH], stayed[LENGTH:], rtol=1e-2, atol=1e-5)
    assert 0 < next_belief[LENGTH:].sum() < 2 * config.leak
    for _ in range(6):  # seen to be elsewhere, it is believed to be
        next_belief = moved.update(at(3, building=1, height=8.0), 1.0)
    assert next_belief.argmax() == rows(3, building=1)


def test_where_nothing_is_left_of_a_belief_nothing_is_known(places):
    robot, other = PlaceFilter(places), PlaceFilter(places)
    robot.update(at(10), 0.0)
    robot.update(at(11), 1.0)
    other.carry_over(robot, np.full(2 * LENGTH, -1))
    np.testing.assert_array_equal(other.belief, PlaceFilter(places).belief)
    np.testing.assert_array_equal(other.update(at(3), 1.0), PlaceFilter(places).update(at(3), 1.0))
