"""The simulated run: what it reveals must be what could be seen from where the robot was, and nothing else."""

import dataclasses
import itertools
import json
import logging
import math

import msgspec
import numpy as np
import pytest

from semloc_core import wire
from semloc_core.errors import BagError, ConfigError, GraphError
from semloc_core.graph.changes.stream import Outcome, UpdateStream
from semloc_core.graph.geodesic import ball
from semloc_core.graph.labels.reading import Reading
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources import graph_at_end, read_run, write_run
from semloc_core.sources.bag import BagReader, BagWriter, decode_string, read_messages
from semloc_core.sources.simulate import SimulationConfig, simulate_traversal
from semloc_core.sources.simulate.route import largest_component, shortest_path
from semloc_core.wire.messages import Object, Place, SceneGraphUpdate

PERFECT = {"miss_rate": 0.0, "false_rate": 0.0, "position_noise_m": 0.0, "fresh_ids": False}


@dataclasses.dataclass(frozen=True)
class Pose:
    stamp_ns: int
    position: tuple[float, float, float]


def scene(places, edges, objects=()):
    graph = SceneGraph()
    graph.apply(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            seq=0,
            full=True,
            places=[Place(key, position) for key, position in places.items()],
            objects=[Object(key, class_, places[parent]) for key, class_, parent in objects],
            edges=[*edges, *((parent, key) for key, _, parent in objects)],
            query_place=None,
        )
    )
    return graph


@pytest.fixture(scope="module")
def grid():
    """8 x 6 places 1 m apart, a wall between columns 3 and 4 with a door in the last row, 40 objects of 4 classes."""
    places = {f"g{x}{y}": (float(x), float(y), 0.0) for x in range(8) for y in range(6)}
    edges = [
        (a, b)
        for a, b in itertools.combinations(places, 2)
        if math.dist(places[a], places[b]) == 1 and not (a[1] == "3" and b[1] == "4" and a[2] != "5")
    ]
    objects = [(f"thing{i}", f"class{i % 4}", f"g{i % 8}{i % 6}") for i in range(40)]
    return scene(places, edges, objects)


def run(graph, seed=0, agents=None, **options):
    config = SimulationConfig.of(**{**PERFECT, **options})
    return list(simulate_traversal(graph, config, np.random.default_rng(seed), agents=agents))


def state(graph):
    """A scene graph as plain values; the order of dictionaries does not count."""
    return {
        "places": graph.places,
        "objects": graph.objects,
        "neighbours": {key: dict(row) for key, row in graph.neighbours.items()},
        "parents": {key: set(row) for key, row in graph.parents.items()},
    }


def replayed(steps):
    stream = UpdateStream()
    for step in steps:
        outcome, _ = stream.apply(wire.decode_update(wire.encode(step.update)))
        assert outcome is Outcome.APPLIED
        yield step, stream.graph


def test_graph_is_what_could_be_seen_from_the_path_so_far(grid):
    """Against a plain reference: the union of geodesic balls around the places that the robot stood on."""
    steps = run(grid, distance_m=25.0, range_m=2.5, speed_mps=1.0, rate_hz=1.0, full_every_s=7.0)
    assert len(steps) == 26
    seen = set()
    for step, graph in replayed(steps):
        assert math.dist(step.position, grid.places[step.place]) < 1e-9  # a step is an edge, so it ends on a place
        seen |= set(ball(grid.neighbours, step.place, 2.5))
        assert set(graph.places) == seen
        assert set(graph.objects) == {key for key, parents in grid.parents.items() if parents & seen}
        assert {p: set(row) for p, row in graph.neighbours.items()} == {p: set(grid.neighbours[p]) & seen for p in seen}
        assert all(graph.parents[key] == grid.parents[key] & seen for key in graph.objects)
        assert step.update.query_place == step.place
    assert len(seen) > 15


def test_range_respects_walls(grid):
    """Beside the wall, the places behind it are 1 m away and 11 m of walking."""
    (step,) = run(grid, start_place="g30", distance_m=0.5, rate_hz=1.0, speed_mps=1.0, range_m=4.0)
    revealed = {place.id for place in step.update.places}
    assert "g00" in revealed
    assert not {"g40", "g50"} & revealed


def test_range_is_measured_from_where_the_robot_is_on_an_edge():
    graph = scene({"a": (0, 0, 0), "b": (10, 0, 0), "c": (13, 0, 0)}, [("a", "b"), ("b", "c")])
    steps = run(graph, start_place="a", range_m=4.0, speed_mps=2.0, rate_hz=1.0, distance_m=10.0)
    revealed = [sorted(place.id for place in step.update.places) for step in steps]
    assert [step.position[0] for step in steps] == [0, 2, 4, 6, 8, 10]
    # At 6 m, b is 4 m ahead; c comes in range at 9 m. Past the middle of the edge b is the nearest place.
    assert revealed == [["a"], [], [], ["b"], [], ["c"]]
    assert [step.place for step in steps] == ["a", "a", "a", "b", "b", "b"]


def test_stamps_numbers_and_full_updates_follow_the_clock(grid):
    steps = run(grid, distance_m=20.0, rate_hz=4.0, speed_mps=0.5, full_every_s=10.0, start_stamp_ns=7)
    updates = [step.update for step in steps]
    assert len(updates) == 161
    assert [u.seq for u in updates] == list(range(161))
    assert [u.stamp_ns for u in updates] == [7 + i * 250_000_000 for i in range(161)]
    assert [u.seq for u in updates if u.full] == [0, 40, 80, 120, 160]
    lengths = [math.dist(a.position, b.position) for a, b in itertools.pairwise(steps)]
    assert max(lengths) < 0.125 + 1e-9
    assert all(u.full for u in (s.update for s in run(grid, distance_m=2.0, full_every_s=0.0)))
    assert len(run(grid, distance_m=0.0, duration_s=30.0, rate_hz=2.0)) == 61


def test_a_full_update_alone_says_what_the_deltas_said(grid):
    options = {
        "distance_m": 30.0,
        "flicker_rate": 0.3,
        "miss_rate": 0.2,
        "false_rate": 0.5,
        "fresh_ids": True,
    }
    with_deltas = run(grid, full_every_s=1e6, **options)
    all_full = run(grid, full_every_s=0.0, **options)
    for (a, delta_graph), (b, full_graph) in zip(replayed(with_deltas), replayed(all_full), strict=True):
        assert a.position == b.position
        assert a.place == b.place
        assert len(delta_graph.places) == len(full_graph.places)
        assert sorted(o.position for o in delta_graph.objects.values()) == sorted(
            o.position for o in full_graph.objects.values()
        )
    assert sum(len(s.update.removed_nodes) for s in with_deltas) > 10


def test_same_seed_same_bytes_other_seed_other_walk(grid):
    encode = [wire.encode(step.update) for step in run(grid, seed=3, miss_rate=0.2, odometry_noise=0.1)]
    assert encode == [wire.encode(step.update) for step in run(grid, seed=3, miss_rate=0.2, odometry_noise=0.1)]
    assert [s.position for s in run(grid, seed=3)] != [s.position for s in run(grid, seed=4)]
    # The detector draws apart from the walk.
    assert [s.position for s in run(grid, seed=3)] == [s.position for s in run(grid, seed=3, miss_rate=0.9)]


def test_order_of_the_graph_dictionaries_has_no_say(grid):
    shuffled = SceneGraph(
        places=dict(reversed(grid.places.items())),
        objects=dict(reversed(grid.objects.items())),
        neighbours={k: dict(reversed(v.items())) for k, v in reversed(grid.neighbours.items())},
        parents=dict(reversed(grid.parents.items())),
        children=dict(reversed(grid.children.items())),
    )
    options = {
        "miss_rate": 0.2,
        "false_rate": 0.3,
        "flicker_rate": 0.1,
        "mislabel_rate": 0.2,
        "distance_m": 40.0,
    }
    assert [wire.encode(s.update) for s in run(grid, **options)] == [
        wire.encode(s.update) for s in run(shuffled, **options)
    ]


def seen_objects(steps):
    found = {}
    for step in steps:
        found.update({thing.id: thing for thing in step.update.objects})
    return found


@pytest.fixture(scope="module")
def store_room():
    """One place that holds 2,000 objects: 1,500 boxes, 500 chairs."""
    objects = [(f"t{i:04d}", "chair" if i % 4 == 0 else "box", "a") for i in range(2000)]
    return scene({"a": (0, 0, 0), "b": (1, 0, 0)}, [("a", "b")], objects)


def test_detector_errors_have_the_rates_that_were_asked_for(store_room):
    true = store_room.objects

    def look(**errors):
        return run(store_room, distance_m=0.1, **errors)

    missed = seen_objects(look(miss_rate=0.25))
    assert 0.70 < len(missed) / 2000 < 0.80
    assert all(true[key] == thing for key, thing in missed.items())
    assert not seen_objects(look(miss_rate=1.0))
    wrong = seen_objects(look(mislabel_rate=0.25))
    assert set(wrong) == set(true)
    assert 0.2 < sum(true[key].class_ != thing.class_ for key, thing in wrong.items()) / 2000 < 0.3
    noisy = seen_objects(look(position_noise_m=0.5))
    offsets = np.array([np.subtract(thing.position, true[key].position) for key, thing in noisy.items()])
    np.testing.assert_allclose(offsets.std(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=0.05)
    invented = [thing for key, thing in seen_objects(look(false_rate=1.25)).items() if key not in true]
    assert 2400 < len(invented) < 2600
    assert 0.70 < sum(thing.class_ == "box" for thing in invented) / len(invented) < 0.80
    moved = look(place_noise_m=0.3)[0].update.places
    assert all(place.position != store_room.places[place.id] for place in moved)


def test_a_missed_object_stays_missed_and_noise_stays_put(grid):
    steps = run(grid, miss_rate=0.5, position_noise_m=0.3, distance_m=200.0, full_every_s=5.0)
    positions = {}
    for step in steps:
        for thing in step.update.objects:
            assert positions.setdefault(thing.id, thing.position) == thing.position
    assert 10 < len(positions) < 30


def test_a_single_class_can_not_be_mislabelled():
    graph = scene({"a": (0, 0, 0)}, [], [("x", "box", "a")])
    assert run(graph, mislabel_rate=1.0)[0].update.objects[0].class_ == "box"


def test_fresh_ids_tell_nothing_and_are_kept_through_the_run(grid):
    fresh, same = run(grid, fresh_ids=True), run(grid, fresh_ids=False)
    names = {}
    for a, b in zip(fresh, same, strict=True):
        assert a.place == b.place
        assert names.setdefault(b.update.query_place, a.update.query_place) == a.update.query_place
        assert [p.position for p in a.update.places] == [p.position for p in b.update.places]
    ids = {node.id for step in fresh for node in (*step.update.places, *step.update.objects)}
    assert not ids & (set(grid.places) | set(grid.objects))
    assert len(set(names.values())) == len(names)


def test_invented_objects_never_take_the_id_of_a_node():
    graph = scene({"a": (0, 0, 0)}, [], [("invented-0", "box", "a"), ("y", "box", "a")])
    (step,) = run(graph, false_rate=1.0)
    assert sorted(thing.id for thing in step.update.objects) == [
        "invented-0",
        "invented-0-",
        "invented-1",
        "y",
    ]


def test_odometry_is_the_walk_in_a_frame_of_its_own(grid):
    steps = run(grid, distance_m=40.0)
    first, straight = steps[0].update.odometry, 0
    assert first.position == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(first.orientation_xyzw, (0, 0, 0, 1), atol=1e-12)
    for a, b in itertools.pairwise(steps):
        walked = math.dist(a.update.odometry.position, b.update.odometry.position)
        assert walked == pytest.approx(math.dist(a.position, b.position))
        if a.update.odometry.orientation_xyzw == b.update.odometry.orientation_xyzw:
            # Not turning, the body moves along its own x axis.
            _, _, z, w = a.update.odometry.orientation_xyzw
            ahead = np.array([1 - 2 * z * z, 2 * z * w, 0.0]) * walked
            moved = np.subtract(b.update.odometry.position, a.update.odometry.position)
            np.testing.assert_allclose(moved, ahead, atol=1e-9)
            straight += 1
    assert straight > 50
    final = steps[-1]
    assert np.linalg.norm(final.update.odometry.position) == pytest.approx(math.dist(final.position, steps[0].position))
    assert all(step.update.odometry is None for step in run(grid, odometry=False))


def test_odometry_noise_grows_with_the_root_of_the_distance(grid):
    ends = {}
    for distance in (10.0, 40.0):
        errors = []
        for seed in range(40):
            exact = run(grid, seed, distance_m=distance, start_place="g00", rate_hz=0.5)[-1].update.odometry.position
            noisy = run(grid, seed, distance_m=distance, start_place="g00", odometry_noise=0.1, rate_hz=0.5)[-1]
            errors.append(np.subtract(noisy.update.odometry.position, exact))
        ends[distance] = np.std(errors)
    assert ends[10.0] == pytest.approx(0.1 * math.sqrt(10), rel=0.25)
    assert ends[40.0] == pytest.approx(0.1 * math.sqrt(40), rel=0.25)
    turned = run(grid, distance_m=40.0, odometry_yaw_noise=0.1)[-1].update.odometry
    assert math.hypot(*turned.orientation_xyzw) == pytest.approx(1.0)
    assert turned != run(grid, distance_m=40.0)[-1].update.odometry


def test_recorded_poses_are_followed_in_order_of_their_stamps(grid):
    poses = [Pose(3, (3.0, 0.2, 1.0)), Pose(1, (0.0, 0.2, 1.0)), Pose(2, (0.0, 0.2, 1.0))]
    steps = run(grid, agents=poses, speed_mps=1.0, rate_hz=2.0, distance_m=1.0)
    assert [step.position for step in steps] == [(i / 2, 0.2, 1.0) for i in range(7)]
    assert [step.place for step in steps] == ["g00", "g00", "g10", "g10", "g20", "g20", "g30"]
    assert {p.id for p in steps[0].update.places} == set(ball(grid.neighbours, "g00", 5.0))
    still = run(grid, agents=[Pose(0, (0.1, 0.0, 0.0))] * 3)
    assert [(s.position, s.place) for s in still] == [((0.1, 0.0, 0.0), "g00")]


def test_pose_far_from_every_place_still_has_a_query_place():
    graph = scene({"a": (0, 0, 0)}, [])
    (step,) = run(graph, agents=[Pose(0, (500.0, 0.0, 0.0))])
    assert step.update.query_place == "a"
    assert [place.id for place in step.update.places] == ["a"]


def test_disconnected_building_is_walked_in_its_largest_part_or_the_starts():
    places = {f"p{i}": (float(i), 0.0, 0.0) for i in range(5)} | {f"a{i}": (float(i), 9.0, 0.0) for i in range(2)}
    edges = [(f"p{i}", f"p{i + 1}") for i in range(4)] + [("a0", "a1")]
    graph = scene(places, edges)
    assert largest_component(graph) == [f"p{i}" for i in range(5)]
    for seed in range(5):
        assert {step.place[0] for step in run(graph, seed)} == {"p"}
    assert {step.place for step in run(graph, start_place="a1")} == {"a0", "a1"}


def test_one_place_places_on_one_spot_and_no_objects():
    (step,) = run(scene({"a": (1, 2, 3)}, []))
    assert (step.position, step.place, step.update.objects) == ((1, 2, 3), "a", [])
    (step,) = run(scene({"a": (1, 2, 3), "b": (1, 2, 3)}, [("a", "b")]))
    assert len(step.update.places) == 2
    stairs = run(scene({"a": (0, 0, 0), "b": (0, 0, 2)}, [("a", "b")]), distance_m=8.0)
    assert len(stairs) == 33
    (step, *_) = run(scene({"a": (0, 0, 0)}, []), false_rate=1.0, mislabel_rate=1.0)
    assert step.update.objects == []


def test_places_on_one_spot_among_others_do_not_trap_the_walk():
    places = {"a": (0, 0, 0), "b": (0, 0, 0), "c": (0, 0, 0), "d": (3, 0, 0)}
    graph = scene(places, [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")])
    steps = run(graph, distance_m=30.0)
    assert {step.place for step in steps} >= {"d"}
    assert shortest_path(graph.neighbours, "a", "d") == ["a", "c", "d"]


def test_what_can_not_be_simulated_is_one_line(grid):
    with pytest.raises(GraphError, match="a graph with places"):
        run(SceneGraph())
    with pytest.raises(GraphError, match="a graph with places"):
        run(SceneGraph(), agents=[Pose(0, (0.0, 0.0, 0.0))])
    with pytest.raises(ConfigError, match="a place of the graph to start from"):
        run(grid, start_place="nowhere")
    for wrong in (
        {"speed_mps": 0.0},
        {"miss_rate": 1.5},
        {"rate_hz": float("nan")},
        {"range_m": -1.0},
        {"no": 1},
    ):
        with pytest.raises(ConfigError):
            run(grid, **wrong)
    with pytest.raises(ConfigError, match="speed_mps"):
        next(simulate_traversal(grid, SimulationConfig(speed_mps=-1.0), np.random.default_rng(0)))


# --- on disk -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_a_run_comes_back_from_disk_with_its_ground_truth(grid, tmp_path, name):
    steps = run(grid, frame_id="office", miss_rate=0.1, fresh_ids=True)
    assert write_run(tmp_path / name, iter(steps)) == len(steps)
    items = list(read_run(tmp_path / name))
    assert len(items) == len(steps)
    for item, step in zip(items, steps, strict=True):
        assert wire.encode(wire.decode_update(item.text)) == wire.encode(step.update)
        assert item.stamp_ns == item.received_ns == item.truth.stamp_ns == step.update.stamp_ns
        assert item.truth.position == step.position
        assert item.truth.frame_id == "office"
    *_, (_, graph) = replayed(steps)
    assert state(graph_at_end(tmp_path / name)) == state(graph)


def test_run_file_is_the_same_for_the_same_seed(grid, tmp_path):
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for file in files:
        write_run(file, run(grid, seed=5, false_rate=0.2, odometry_noise=0.1))
    assert files[0].read_bytes() == files[1].read_bytes()


def text_of(steps):
    return [wire.encode(step.update).decode() for step in steps]


def test_truth_pairs_by_stamp_whichever_comes_first_and_whenever_it_was_received(grid, tmp_path):
    steps = run(grid, distance_m=50.0)[:40]
    texts = text_of(steps)
    with BagWriter(tmp_path / "run.mcap") as bag:
        for i in range(0, 40, 2):
            a, b = steps[i], steps[i + 1]
            bag.write_point("/ground_truth", a.update.stamp_ns, "map", a.position)
            bag.write_string("/scene_graph", 2 * i, texts[i])
            bag.write_string("/scene_graph", 2 * i + 1, texts[i + 1])
            if i % 4 == 0:  # the others never have one
                bag.write_point("/ground_truth", b.update.stamp_ns, "map", b.position)
    items = list(read_run(tmp_path / "run.mcap"))
    assert [item.text for item in items] == texts
    for i, (item, step) in enumerate(zip(items, steps, strict=True)):
        assert (item.truth is None) == (i % 4 == 3)
        assert item.truth is None or item.truth.position == step.position


def test_run_without_truth_and_with_malformed_updates(grid, tmp_path, caplog):
    steps = run(grid, distance_m=60.0, full_every_s=20.0)
    texts = text_of(steps)
    texts[3] = texts[3][:-5]  # the deltas after it have no base until the next full update
    texts.insert(60, "[]")
    with BagWriter(tmp_path / "run.mcap") as bag:
        for i, value in enumerate(texts):
            bag.write_string("/robot/scene_graph", i, value)
    items = list(read_run(tmp_path / "run.mcap", topic="/robot/scene_graph"))
    assert [item.text for item in items] == texts
    assert all(item.truth is None for item in items)
    assert items[3].stamp_ns == 3
    with caplog.at_level(logging.WARNING, "semloc_core"):
        graph = graph_at_end(tmp_path / "run.mcap", reading=Reading(topic="/robot/scene_graph"))
    assert "left out" in caplog.text
    assert "missing" in caplog.text
    *_, (_, complete) = replayed(steps)
    assert state(graph) == state(complete)
    assert [item.text for item in read_run(tmp_path / "run.mcap")] == texts  # the only topic with updates
    for read in (lambda: list(read_run(tmp_path / "run.mcap", topic="/other")),
                 lambda: graph_at_end(tmp_path / "run.mcap", reading=Reading(topic="/other"))):  # fmt: skip
        with pytest.raises(BagError, match=r"updates on /other .*no such topic; topics: /robot/scene_graph \(std_msgs"):
            read()


def test_graph_from_before_a_gap_at_the_end_is_kept(grid, tmp_path):
    steps = run(grid, distance_m=20.0, full_every_s=1e6)
    write_run(tmp_path / "run.mcap", steps[:10] + steps[20:])
    *_, (_, graph) = replayed(steps[:10])
    assert state(graph_at_end(tmp_path / "run.mcap")) == state(graph)


def test_run_cut_off_in_mid_write_gives_its_first_part(grid, tmp_path):
    steps = run(grid, distance_m=60.0, full_every_s=0.0)
    write_run(tmp_path / "run.mcap", steps)
    raw = (tmp_path / "run.mcap").read_bytes()
    assert len(raw) > 2 * 256 * 1024
    (tmp_path / "run.mcap").write_bytes(raw[: len(raw) * 2 // 3])
    reader = BagReader(tmp_path / "run.mcap", ["/scene_graph"])
    found = [decode_string(message.data) for message in reader]
    assert reader.truncated
    assert 0 < len(found) < len(steps)
    assert found == text_of(steps)[: len(found)]
    assert graph_at_end(tmp_path / "run.mcap").places


@pytest.mark.data
@pytest.mark.parametrize("name", ["hydra/apartment_short.json", "hydra/mp3d_partial_600.json", "goseek/office.json"])
def test_real_buildings_are_walked_by_goals_and_by_their_poses(data_root, tmp_path, name):
    from semloc_core.sources.hydra import read_hydra

    file = read_hydra(data_root / name)
    config = SimulationConfig.of(distance_m=30.0, speed_mps=1.0, rate_hz=1.0, flicker_rate=0.02)
    count = write_run(tmp_path / "goals.mcap", simulate_traversal(file.graph, config, np.random.default_rng(0)))
    assert count == 31
    graph = graph_at_end(tmp_path / "goals.mcap")
    assert graph.objects
    assert len(graph.places) > 20
    if file.agents:
        steps = simulate_traversal(file.graph, config, np.random.default_rng(0), agents=file.agents)
        assert write_run(tmp_path / "poses.mcap", steps) >= 10
        first = next(read_run(tmp_path / "poses.mcap")).truth
        assert first.position == file.agents[0].position
    for message in read_messages(tmp_path / "goals.mcap", ["/scene_graph"]):
        assert msgspec.json.decode(decode_string(message.data)) == json.loads(decode_string(message.data))
