"""What detectors, trackers and mappers send that they should not: refused whole, or taken for what it is."""

import math

import numpy as np
import pytest

from semloc_core.errors import GraphError, MessageError
from semloc_core.graph import UpdateStream
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import Grid
from semloc_core.sources.detections.growth.builder import GraphBuilder
from semloc_core.sources.detections.growth.cells import Cells
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.things import MOST, Detection, View
from semloc_core.wire import decode_update, encode, quaternion_of

NAN = float("nan")


def at(x, y=0.0, z=0.0, yaw=0.0):
    return Rigid.of((x, y, z), quaternion_of(yaw))


def broken(x=1.0, w=1.0):
    return Rigid(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, w]))


def seen(scores, x, y=0.0, size=(0.5, 0.5, 0.5), track=""):
    return Detection(scores, at(x, y), size, track)


class Robot:
    def __init__(self, **options):
        self.builder, self.stream, self.step = GraphBuilder(BuilderConfig.of(**options), "odom"), UpdateStream(), 0

    def see(self, *detections, robot=None, times=1):
        for _ in range(times):
            pose = robot or at(0.0)
            self.builder.see(View(self.step * 500_000_000, pose, pose, detections, "camera"))
            self.step += 1
            self.said()
        return sorted((o.class_, *(round(v, 2) for v in o.position)) for o in self.graph.objects.values())

    def said(self):
        self.stream.apply(decode_update(encode(self.builder.update())))

    @property
    def graph(self):
        return self.stream.graph


@pytest.mark.parametrize(
    "wrong",
    [
        Detection({"chair": 0.9}, broken(NAN)),
        Detection({"chair": 0.9}, broken(2e9)),
        Detection({"chair": 0.9}, broken(w=NAN), (1.0, 1.0, 1.0)),
        seen({"chair": 0.9}, 1.0, size=(NAN, 1.0, 1.0)),
        seen({"chair": NAN}, 1.0),
        seen({"chair": 87.0}, 1.0),
        seen({"chair": -0.1}, 1.0),
    ],
)
def test_a_number_that_is_none_is_refused_with_all_that_was_seen(wrong):
    robot = Robot(confirm_after=1)
    robot.see(seen({"bed": 0.9}, 2.0))
    before = encode(robot.graph.to_update(0, 0, "odom"))
    with pytest.raises(MessageError, match="expected"):
        robot.see(seen({"tv": 0.9}, 4.0), wrong, robot=at(5.0))
    good = View(0, at(5.0), at(5.0), (seen({"tv": 0.9}, 4.0),), "left")
    with pytest.raises(MessageError):
        robot.builder.see(good, good._replace(detections=(wrong,)))  # nor does one camera count without the other
    robot.said()
    assert encode(robot.graph.to_update(0, 0, "odom")) == before


def test_a_robot_that_is_nowhere_is_refused():
    robot = Robot()
    for pose in (broken(NAN), broken(w=NAN), broken(-2e9)):
        with pytest.raises(MessageError):
            robot.see(robot=pose)
        with pytest.raises(MessageError):
            robot.builder.walk(pose, 0)
    robot.said()
    assert not robot.graph.places


def test_more_than_a_detector_sees_is_refused():
    robot = Robot()
    with pytest.raises(MessageError, match=f"at most {MOST}"):
        robot.see(*[seen({"chair": 0.9}, 1.0 + 2 * i) for i in range(MOST + 1)])


def test_what_has_no_name_has_a_place_and_no_label():
    robot = Robot(min_score=0.0)
    found = robot.see(seen({}, 1.0), seen({"unknown": 0.9}, 2.0), seen({"chair": 0.0}, 3.0), times=2)
    assert found == [("unknown", 1.0, 0.0, 0.0), ("unknown", 2.0, 0.0, 0.0), ("unknown", 3.0, 0.0, 0.0)]
    assert all(thing.labels is None for thing in robot.graph.objects.values())
    robot.see(seen({"chair": 0.4, "unknown": 0.5}, 1.0), times=8)
    (chair,) = (thing for thing in robot.graph.objects.values() if thing.position[0] == 1.0)
    assert (chair.class_, chair.labels) == ("chair", None)


def test_a_score_a_rounding_above_one_is_one():
    assert Robot(confirm_after=1).see(seen({"chair": 1.0000001}, 1.0)) == [("chair", 1.0, 0.0, 0.0)]


def test_what_a_detector_says_twice_of_a_thing_is_one_and_two_things_are_two():
    twice = (seen({"couch": 0.7}, 1.05), seen({"chair": 0.8}, 1.0))  # suppressed class by class
    assert Robot().see(*twice, times=4) == [("chair", 1.0, 0.0, 0.0)]
    assert len(Robot().see(seen({"chair": 0.8}, 1.0, size=None), seen({"chair": 0.7}, 1.02, size=None), times=4)) == 1
    beside = (seen({"chair": 0.8}, 1.0), seen({"chair": 0.8}, 1.0, 0.5))
    assert len(Robot().see(*beside, times=4)) == 2
    on_it = (seen({"table": 0.8}, 2.0, size=(1.5, 1.0, 0.8)), seen({"laptop": 0.8}, 2.0, size=(0.3, 0.3, 0.2)))
    assert len(Robot().see(*on_it, times=4)) == 2
    tracked = (seen({"chair": 0.8}, 1.0, track="1"), seen({"chair": 0.8}, 1.05, track="2"))
    assert len(Robot().see(*tracked, times=4)) == 2


def test_a_huge_or_far_detection_takes_no_other_objects_place():
    robot = Robot(confirm_after=1)
    robot.see(seen({"chair": 0.9}, 2.0, size=None))
    found = robot.see(seen({"chair": 0.9}, 40.0, size=(1e9, 1e9, 1e9)), seen({"chair": 0.9}, 1e8, size=None))
    assert [x for _, x, _, _ in found] == [2.0, 40.0, 1e8]
    robot.builder.set_grid(Grid(np.zeros((60, 60), dtype=np.int8), 0.1, (-3.0, -3.0, 0.0)))
    robot.said()
    assert len(robot.graph.objects) == 3
    assert all(robot.graph.parents[key] for key in robot.graph.objects)


def test_a_tracker_that_gives_new_ids_for_ever_and_a_detector_of_endless_names_fill_nothing():
    robot = Robot(full_every_s=3600.0)
    for i in range(300):
        robot.see(seen({f"name {i}": 0.9, "chair": 0.8}, 1.0, track=str(i)))
    objects = robot.builder._objects
    assert len(objects.things) == len(objects._tracks) == 1
    assert all(len(thing.labels) < 120 for thing in objects.things.values())
    ((_, x, _, _),) = robot.see(seen({"chair": 0.9}, 2.5, track="299"))
    assert x == 2.5  # the latest id holds, and says that it moved


def test_a_frame_that_jumps_joins_nothing_across():
    robot = Robot(confirm_after=1)
    for i in range(12):
        robot.see(seen({"chair": 0.9}, 1.0, track="7"), robot=at(1e8 * (i % 2), 0.0, 50.0 * (i % 3)))
    graph = robot.graph
    assert len(graph.places) == len(graph.objects) == 6
    assert not any(graph.neighbours[place] for place in graph.places)


def test_grids_of_any_resolution_origin_and_turn_leave_what_was_said_and_what_is_the_same():
    robot, rng = Robot(confirm_after=1, full_every_s=3600.0), np.random.default_rng(1)
    robot.see(seen({"chair": 0.9}, 1.0))
    taken = 0
    for i in range(12):
        cells = np.where(rng.random((100, 120)) < 0.002, 100, 0).astype(np.int8)
        x, y, yaw = rng.uniform((-4.0, -4.0, -math.pi), (-1.0, -1.0, math.pi)).tolist()
        try:
            robot.builder.set_grid(Grid(cells, float(rng.choice([0.02, 0.05, 0.1])), (x, y, yaw)))
            taken += 1
        except GraphError:
            continue
        robot.see(seen({"chair": 0.9}, 1.0 - 0.1 * i), robot=at(0.1 * i))
        assert all(robot.graph.parents[key] for key in robot.graph.objects)
        assert robot.graph.query_place in robot.graph.places
    assert taken > 6
    told = robot.graph.to_update(0, 0, "odom")
    robot.builder.ask_full()
    robot.said()
    again = robot.graph.to_update(0, 0, "odom")
    assert (told.places, told.objects, told.edges) == (again.places, again.objects, again.edges)


@pytest.mark.parametrize(
    ("resolution", "origin"),
    [(0.05, (1e300, 0.0, 0.0)), (1e300, (0, 0, 0)), (1e8, (0, 0, 0)), (NAN, (0, 0, 0))],
)
def test_a_grid_that_reaches_farther_than_coordinates_do_is_refused(resolution, origin):
    with pytest.raises(GraphError, match="expected"):
        Grid(np.zeros((50, 50), dtype=np.int8), resolution, origin)


def test_what_a_full_update_says_of_an_object_that_stands_still_is_what_was_said():
    robot = Robot(confirm_after=1, full_every_s=3600.0)
    for i in range(6):
        robot.see(seen({"chair": 0.9}, 2.0 + 0.01 * (i % 2)))
    said = robot.graph.objects
    robot.builder.ask_full()
    robot.said()
    assert robot.graph.objects == said


def test_what_a_view_looks_at_does_not_grow_with_the_graph(monkeypatch):
    looked = []
    near = Cells.near

    def counted(self, position, radius_m):
        found = list(near(self, position, radius_m))
        looked.append(len(found))
        return iter(found)

    monkeypatch.setattr(Cells, "near", counted)
    robot, costs, told = Robot(confirm_after=1, full_every_s=3600.0), {}, {}
    for i in range(300):
        looked.clear()
        here = at(0.5 * i, yaw=0.0)
        both = seen({"chair": 0.9}, 2.0), seen({"tv": 0.9}, 2.0, 1.5)
        robot.builder.see(View(i * 500_000_000, here, here, both, "camera"))
        update = robot.builder.update()
        robot.stream.apply(update)
        costs[i], told[i] = sum(looked), (len(update.places), len(update.objects), len(update.edges))
    assert len(robot.graph.objects) >= 200
    early, late = range(30, 150), range(180, 300)
    assert max(costs[i] for i in late) <= max(costs[i] for i in early)
    assert max(told[i] for i in late) <= max(told[i] for i in early)
