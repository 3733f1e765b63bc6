"""Graphs without Hydra: detections, grids, nav2's maps; each with what must come out."""

import math

import numpy as np
import pytest
from PIL import Image

from semloc_core.errors import FileFormatError, MessageError
from semloc_core.graph import SceneGraph, UpdateStream
from semloc_core.sources import (
    DetectorConfig,
    Grid,
    StreamConfig,
    graph_at_end,
    node_id,
    read_nav2,
    read_objects,
    simulate_detections,
    write_detections,
)
from semloc_core.sources.detections.frames import Frames, LateError, NoPathError, Rigid
from semloc_core.sources.detections.grid import free_places
from semloc_core.sources.detections.growth.builder import GraphBuilder
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.things import Detection, View
from semloc_core.sources.detections.nav2 import graph_of
from semloc_core.wire import Object, Place, SceneGraphUpdate, decode_update, encode, quaternion_of


def at(x, y=0.0, z=0.0, yaw=0.0):
    return Rigid.of((x, y, z), quaternion_of(yaw))


def seen(class_, x, y=0.0, z=0.0, score=0.9, track="", size=(0.5, 0.5, 0.5)):
    return Detection({class_: score}, at(x, y, z), size, track)


def view(step, robot, *detections):
    return View(round(step * 0.5e9), robot, robot, detections, "camera")


class Watched:
    """A builder, and a graph that gets its updates."""

    def __init__(self, **options):
        self.builder, self.stream, self.step = GraphBuilder(BuilderConfig.of(**options), "odom"), UpdateStream(), 0
        self.updates = []

    def see(self, robot, *detections, times=1):
        for _ in range(times):
            self.builder.see(view(self.step, robot, *detections))
            self.step += 1
            self.updates.append(self.builder.update())
            self.stream.apply(self.updates[-1])
        return sorted((o.class_, *(round(v, 2) for v in o.position)) for o in self.graph.objects.values())

    @property
    def graph(self):
        return self.stream.graph


def test_an_object_is_confirmed_fused_and_forgotten_when_looked_at_and_not_seen():
    robot = Watched(confirm_after=3, forget_after=4)
    assert robot.see(at(0), seen("chair", 2.0), times=2) == []
    assert robot.see(at(0), seen("chair", 2.3)) == [("chair", 2.08, 0.0, 0.0)]
    assert robot.see(at(0), times=3) == [("chair", 2.08, 0.0, 0.0)]
    assert robot.see(at(0, yaw=math.pi), times=9) == [("chair", 2.08, 0.0, 0.0)]  # it looks the other way
    assert robot.see(at(0)) == []


def test_classes_are_a_histogram_and_confusions_do_not_make_another_object():
    robot = Watched(confirm_after=1)
    robot.see(at(0), seen("chair", 2.0), times=3)
    assert robot.see(at(0), seen("couch", 2.1), times=2) == [("chair", 2.02, 0.0, 0.0)]  # less than 2 cm from 2.04
    assert robot.see(at(0), seen("couch", 2.1), times=4)[0][0] == "couch"
    assert len(robot.see(at(0), seen("couch", 2.1), seen("couch", 3.5))) == 2
    assert robot.see(at(0), Detection({}, at(1.0, 0.9), None))[2][0] == "unknown"


def test_what_an_object_may_be_is_published_where_it_was_seen_as_several():
    robot = Watched(confirm_after=1)
    robot.see(at(0), seen("chair", 2.0, score=0.8), times=3)
    (thing,) = robot.graph.objects.values()
    assert thing.labels is None
    robot.see(at(0), Detection({}, at(2.0)))
    robot.see(at(0), Detection({"couch": 0.5, "chair": 0.4}, at(2.0)))
    (thing,) = robot.graph.objects.values()
    assert thing.labels == {"chair": 0.56, "couch": 0.1}  # of five sightings, one of them without a name
    assert decode_update(encode(robot.updates[-1])).objects == [thing]
    robot.see(at(0), Detection({"chair": 0.56, "couch": 0.1}, at(2.0)))
    assert robot.updates[-1].objects == [], "what hardly changed is not written anew"


def test_a_tracking_id_holds_where_the_object_moves():
    robot = Watched(confirm_after=1)
    for x in (1.0, 2.0, 3.0):
        found = robot.see(at(0), seen("cart", x, track="4"))
        assert len(found) == 1
    assert robot.see(at(0), seen("cart", 3.0), seen("cart", 2.0, track="9")) != found


def test_a_view_is_taken_whole_or_not_at_all():
    robot = Watched(confirm_after=1)
    robot.see(at(0), seen("chair", 2.0))
    before = encode(robot.graph.to_update(0, 0, "odom"))
    for wrong in (seen("chair", 2.0, score=1.5), seen("", 1.0), seen("chair", 1.0, size=(-1.0, 1.0, 1.0))):
        with pytest.raises(MessageError):
            robot.builder.see(view(robot.step, at(5), seen("couch", 1.0), wrong))
    assert (
        encode(SceneGraph.from_update(robot.see(at(0)) and robot.graph.to_update(0, 0, "odom")).to_update(0, 0, "odom"))
        == before
    )


def test_places_follow_the_way_and_do_not_reach_through_where_nobody_walked():
    robot = Watched(place_spacing_m=1.0, full_every_s=1000.0)
    way = [(0.5 * i, 0.0) for i in range(13)] + [(6.0, 0.5 * i) for i in range(1, 9)]
    way += [(6.0 - 0.5 * i, 4.0) for i in range(1, 13)] + [(0.0, 4.0 - 0.5 * i) for i in range(1, 7)]  # ends at (0, 1)
    for x, y in way:
        robot.see(at(x, y))
    graph, first = robot.graph, min(robot.graph.places)
    assert len(graph.places) > 10
    robot.see(at(0.0, 0.5))
    near = graph.query_place
    assert math.dist(graph.places[first], graph.places[near]) < 0.6
    assert near not in graph.neighbours[first]  # a wall could be between: the way back is long
    robot.see(at(0.0, 0.1))
    assert graph.query_place == first  # the robot stands on it
    assert near in graph.neighbours[first]


def walls():
    """Two rooms, 4 m × 6 m, a diagonal wall a cell thick in one; a door of 0.8 m between them."""
    cells = np.zeros((80, 120), dtype=np.int8)
    cells[[0, -1]] = 100
    cells[:, [0, -1, 60]] = 100
    cells[30:46, 60] = 0
    for i in range(25):
        cells[20 + i, 80 + i] = 100
    return Grid(cells, 0.05, (-3.0, 2.0, 0.5))


def test_places_of_a_grid_are_joined_through_doors_and_across_no_wall():
    grid = walls()
    space = free_places(grid, 0.6, 0.25)
    a, b = space.points[space.edges[0]], space.points[space.edges[1]]
    for part in np.linspace(0.0, 1.0, 400):
        assert grid.at(grid.free, a + part * (b - a)).all()
    joined = {0}
    for _ in range(len(space.points)):
        joined |= {q for edge in space.edges.T.tolist() for q in edge if joined & {*edge}}
    assert len(joined) == len(space.points) > 50
    assert free_places(grid, 0.6, 0.45).edges.shape != space.edges.shape
    closed = Grid(np.where(np.arange(120) == 60, 100, grid.cells).astype(np.int8), 0.05, grid.origin)
    shut = free_places(closed, 0.6, 0.25)
    side = ((shut.points - np.array(grid.origin[:2])) @ grid._turn)[:, 0] < 3.0
    assert (side[shut.edges[0]] == side[shut.edges[1]]).all()


def test_a_grid_comes_and_goes_under_a_graph_that_stays_whole():
    robot, grid = Watched(confirm_after=1, full_every_s=1000.0), walls()
    x, y = (float(v) for v in grid.centres(np.array([40]), np.array([20]))[0])
    robot.see(at(x, y), seen("chair", 1.0))
    robot.builder.set_grid(grid)
    robot.see(at(x, y), seen("chair", 1.0))
    many, whole = len(robot.graph.places), robot.graph
    assert many > 50
    assert all(whole.parents[key] for key in whole.objects)
    kept = set(whole.places)
    cells = grid.cells.copy()
    cells[:, 61:] = -1
    robot.builder.set_grid(Grid(cells, grid.resolution, grid.origin))
    robot.see(at(x, y), seen("chair", 1.0))
    assert 10 < len(robot.graph.places) < many
    assert len(kept & set(robot.graph.places)) > 0.8 * len(robot.graph.places)
    robot.builder.ask_full()
    grown = robot.graph.to_update(0, 0, "odom")
    robot.see(at(x, y), seen("chair", 1.0))
    again = robot.graph.to_update(0, 0, "odom")
    assert (grown.places, grown.edges, grown.objects) == (again.places, again.edges, again.objects)


def test_nav2s_map_is_read_as_map_server_does(tmp_path):
    shades = np.array([[0, 100, 205, 254], [255, 88, 166, 192]], dtype=np.uint8)
    Image.fromarray(shades).save(tmp_path / "m.pgm")

    def cells(mode, negate=0, image="m.pgm"):
        text = f"image: {image}\nresolution: 0.1\norigin: [1.0, 2.0, 1.5707963267948966]\nnegate: {negate}\n"
        text += f"occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: {mode}\n"
        (tmp_path / "m.yaml").write_text(text)
        return read_nav2(tmp_path / "m.yaml")

    grid = cells("trinary")
    assert grid.cells.tolist() == [[0, 100, -1, -1], [100, -1, -1, 0]]  # 205 is just above free_thresh
    assert np.allclose(grid.centres(np.array([0]), np.array([2])), [[0.95, 2.25]])
    assert cells("trinary", 1).cells.tolist() == [[100, -1, 100, 100], [0, -1, 100, 100]]
    assert cells("Scale").cells.tolist() == [[0, 100, 34, 11], [100, 91, 0, 0]]
    assert cells("raw").cells.tolist() == [[-1, 88, -1, -1], [0, 100, -1, -1]]
    see_through = np.dstack([shades] * 3 + [np.array([[255, 255, 0, 255], [255, 255, 255, 255]], dtype=np.uint8)])
    Image.fromarray(see_through).save(tmp_path / "m.png")
    assert cells("scale", image="m.png").cells[1].tolist() == [100, 91, -1, 0]
    # In trinary opacity counts as a fourth channel: black is 0.75 occupied, and see-through 205 as dark as 154.
    assert cells("trinary", image="m.png").cells.tolist() == [[0, -1, -1, 0], [100, -1, -1, 0]]
    for line in ("mode: quick", "negate: maybe", "origin: [1, 2]", "resolution: 0"):
        key = line.split(":")[0]
        good = (tmp_path / "m.yaml").read_text().splitlines()
        (tmp_path / "bad.yaml").write_text("\n".join([*(row for row in good if not row.startswith(key)), line]))
        with pytest.raises(FileFormatError, match=key):
            read_nav2(tmp_path / "bad.yaml")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("o.csv", "class, x, y, z, size\nchair,1,2,0.5,0.4\n\ntv,3,4,1,\n"),
        ("o.csv", "X,label,Y,Z,size_x,size_y,size_z\n1,chair,2,0.5,0.4,0.4,0.4\n3,tv,4,1,,,\n"),
        ("o.yaml", "objects:\n- {class: chair, x: 1, y: 2, z: 0.5, size: 0.4}\n- {class: tv, position: [3, 4, 1]}\n"),
        (
            "o.json",
            '[{"class": "chair", "position": [1, 2, 0.5], "size": [0.4, 0.4, 0.4]},'
            ' {"class": "tv", "x": 3, "y": 4, "z": 1}]',
        ),
    ],
)
def test_objects_are_read_from_each_form(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert read_objects(tmp_path / name) == [("chair", (1, 2, 0.5), (0.4, 0.4, 0.4)), ("tv", (3, 4, 1), None)]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("class,x,y\nchair,1,2\n", "header"),
        ("class,x,y,z\nchair,1,2,high\n", "line 2"),
        ("class,x,y,z\n,1,2,3\n", "class"),
        ("class;x;y;z\nchair;1,5;2;3\n", "commas part fields, not semicolons"),
        ("class\tx\ty\tz\nchair\t1\t2\t3\n", "not tabs"),
        ("class,x,y,z\nchair,1,5,2,3\n", "line 2 .got 5; decimals have points"),
        ("class,x,x,y,z\nchair,1,2,3,4\n", "each column once"),
        ('class,x,y,z\n"a\nb",1,2,3\n', "name for a class"),
        ("class,x,y,z\n" + "a" * 200_000 + ",1,2,3\n", "CSV"),
        ("class,x,y,z\nchair,1,2\n", "line 2"),
        ("class,x,y,z\nchair,1,2,inf\n", "number"),
    ],
)
def test_a_wrong_list_of_objects_is_said_in_a_line(tmp_path, text, line):
    (tmp_path / "o.csv").write_text(text)
    with pytest.raises(FileFormatError, match=line):
        read_objects(tmp_path / "o.csv")


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("o.yaml", "- {class: no, x: 1, y: 2, z: 3}\n", "quote it"),
        ("o.yaml", "- {class: [a], x: 1, y: 2, z: 3}\n", "name for a class"),
        ("o.yaml", "!!python/object/apply:os.system ['ls']\n", "YAML or JSON"),
        ("o.json", '[{"class": "a", "x": NaN, "y": 1, "z": 1}]', "number"),
        ("o.json", "[" * 5000 + "]" * 5000, "YAML or JSON"),
        ("o.txt", "class,x,y,z\nchair,1,2,3\n", "ends in .csv"),
    ],
)
def test_a_wrong_record_is_said_in_a_line(tmp_path, name, text, line):
    (tmp_path / name).write_text(text)
    with pytest.raises(FileFormatError, match=line):
        read_objects(tmp_path / name)


def test_json_laid_out_with_tabs_and_csv_with_empty_columns_are_read(tmp_path):
    (tmp_path / "o.json").write_text('[\n\t{"class": "tv", "position": {"x": 3, "y": 4, "z": 1}}\n]')
    (tmp_path / "o.csv").write_text("class,x,y,z,,\ntv,3,4,1,,\n")
    assert read_objects(tmp_path / "o.json") == read_objects(tmp_path / "o.csv") == [("tv", (3, 4, 1), None)]


def test_objects_hang_on_places_this_side_of_the_wall():
    cells = np.zeros((60, 60), dtype=np.int8)
    cells[:, 30] = 100
    grid = Grid(cells, 0.1, (0.0, 0.0, 0.0))
    graph, left = graph_of(
        grid, [("tv", (2.9, 3.0, 1.0), None), ("car", (90.0, 0.0, 0.0), None)], spacing_m=1.0, radius_m=0.6
    )
    (parents,) = graph.parents.values()
    assert all(graph.places[place][0] < 3.0 for place in parents)
    assert left == [1]


def test_transforms_are_chained_interpolated_and_said_to_be_late():
    frames = Frames()
    frames.add("base", "camera", 0, at(1.0), static=True)
    frames.add("odom", "base", 1000, at(0.0, yaw=0.0))
    frames.add("odom", "base", 2000, at(2.0, yaw=math.pi / 2))
    frames.add("map", "odom", 0, at(0.0, 5.0), static=True)
    found = frames.lookup("map", "camera", 1500)
    assert np.allclose(found.translation, [1 + math.sqrt(0.5), 5 + math.sqrt(0.5), 0])
    assert np.allclose((frames.lookup("camera", "map", 1500) @ found).translation, 0)
    with pytest.raises(LateError):
        frames.lookup("odom", "camera", 2001)
    with pytest.raises(NoPathError):
        frames.lookup("odom", "lidar", 1500)
    with pytest.raises(MessageError, match="older"):
        frames.lookup("odom", "base", 999)


def house(length=14, width=4):
    """Places a metre apart, an object on every second one."""
    names = {(i, j): node_id("p", i * width + j) for i in range(length) for j in range(width)}
    edges = [(names[i, j], names[n]) for i, j in names for n in ((i + 1, j), (i, j + 1)) if n in names]
    classes = ["chair", "tv", "plant", "bed", "sink", "clock"]
    things = [
        Object(node_id("O", k), classes[(5 * k + k // 3) % 6], (i + 0.3, j + 0.3, 0.3), (0.4, 0.4, 0.4))
        for k, (i, j) in enumerate(sorted(names)[::2])
    ]
    links = [(names[key], thing.id) for key, thing in zip(sorted(names)[::2], things, strict=True)]
    return SceneGraph.from_update(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1", stamp_ns=0, frame_id="map", seq=0, full=True,
            places=[Place(name, (float(i), float(j), 0.4)) for (i, j), name in names.items()],
            objects=things, edges=edges + links, query_place=None,
        )
    )  # fmt: skip


def test_a_bag_of_detections_becomes_the_graph_that_was_walked(tmp_path):
    building, rng = house(), np.random.default_rng
    config = DetectorConfig.of(distance_m=60.0, cameras=2, depth_noise=0.001, false_rate=0.0)
    write_detections(tmp_path / "run.mcap", simulate_detections(building, config, rng(3)))
    graph = graph_at_end(tmp_path / "run.mcap")
    near = 0
    for thing in graph.objects.values():
        truth = min(building.objects.values(), key=lambda o, thing=thing: math.dist(o.position, thing.position))
        near += math.dist(truth.position, thing.position) < 0.1 and truth.class_ == thing.class_
    assert near >= 0.95 * len(graph.objects)
    assert len(graph.objects) >= 20
    again = graph_at_end(tmp_path / "run.mcap", detections=StreamConfig())
    assert encode(again.to_update(0, 0, "odom")) == encode(graph.to_update(0, 0, "odom"))
