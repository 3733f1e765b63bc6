"""What is a run: topics, robots, truth, Hydra's own messages, JSON text; each with what it must give."""

import logging
import re

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer
from small_building import building_update

from semloc_core import wire
from semloc_core.errors import BagError
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources import Run, graph_at_end, is_run, read_run
from semloc_core.sources.bag import BagWriter, StampedPose, read_messages
from semloc_core.sources.runs.kind import robots_of
from semloc_core.sources.truth import TruthMatcher

UPDATE = building_update(seed=0)
STEP_NS = 500_000_000
DSG = "hydra_msgs/msg/DsgUpdate"
DSG_FIELDS = (
    "std_msgs/Header header\nuint8[] layer_contents\nuint64[] deleted_nodes\nuint64[] deleted_edges\n"
    "bool full_update\nuint64 sequence_number\n"
)


def texts(count=6):
    graph = SceneGraph.from_update(UPDATE)
    places = sorted(graph.places)
    return [
        wire.encode(graph.to_update(0, (i + 1) * STEP_NS, "map", places[i % len(places)])).decode()
        for i in range(count)
    ]


def write(path, topics=("/scene_graph",), truth="/ground_truth", off_ns=0):
    with BagWriter(path) as bag:
        for i, text in enumerate(texts()):
            stamp = (i + 1) * STEP_NS
            for topic in topics:
                bag.write_string(topic, stamp, text)
            if truth:
                bag.write_pose(truth, stamp + off_ns, "map", (float(i), 0.0, 0.0), (0.0, 0.0, 0.6, 0.8))
    return path


def test_truth_of_the_nearest_stamp_is_taken_within_the_tolerance(tmp_path):
    path = write(tmp_path / "run.mcap", off_ns=1_000_000)
    items = list(read_run(path))
    assert [item.truth.position[0] for item in items] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert items[0].truth.orientation_xyzw == (0.0, 0.0, 0.6, 0.8)
    assert all(item.truth is None for item in read_run(path, tolerance_s=0.0005))


def test_the_nearest_of_many_truths_wins_and_the_interval_is_known():
    matcher = TruthMatcher(tolerance_ns=10)
    given = [found for stamp in (0, 7, 14, 30) for found in matcher.truth(pose(stamp))]
    given += [*matcher.item(9, "a"), *matcher.item(22, "b"), *matcher.item(45, "c"), *matcher.rest()]
    assert [(item, truth and truth.stamp_ns) for item, truth in given] == [("a", 7), ("b", 14), ("c", None)]
    assert (matcher.seen, matcher.matched, matcher.largest_ns) == (4, 2, 8)


def pose(stamp):
    return StampedPose(stamp, "map", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_the_only_topic_with_updates_is_taken_with_the_truth_beside_it_and_said(tmp_path):
    path = tmp_path / "run.mcap"
    with BagWriter(path) as bag:
        for i, text in enumerate(texts()):
            bag.write_string("/chatter", i, "hello")
            bag.write_string("/robot1/scene_graph", i, text)
            bag.write_pose("/robot1/ground_truth", (i + 1) * STEP_NS, "map", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    run = Run(path)
    assert run.topic == "/robot1/scene_graph"
    assert run.said == ["updates are taken from /robot1/scene_graph, the only topic that has any"]
    assert all(item.truth.position == (1.0, 2.0, 3.0) for item in read_run(path))
    with pytest.raises(BagError, match=r"on /no .*no such topic.*/chatter.*/robot1/scene_graph"):
        Run(path, topic="/no")


def test_several_robots_are_a_run_each_the_first_by_default(tmp_path):
    path = write(tmp_path / "run.mcap", ("/b/scene_graph", "/a/scene_graph"), truth="")
    assert (Run(path).topic, Run(path, robot="b").topic) == ("/a/scene_graph", "/b/scene_graph")
    assert Run(path).said == ["2 robots: a, b; this is a's run (/a/scene_graph)"]
    with pytest.raises(BagError, match="one of the robots a, b in"):
        Run(path, robot="c")
    other = write(tmp_path / "other.mcap", ("/graph", "/graph_old"), truth="")
    with pytest.raises(BagError, match="--topic chooses one"):
        Run(other)
    assert robots_of(["/scene_graph", "/two/scene_graph"]) == {
        "/scene_graph": "/scene_graph",
        "two": "/two/scene_graph",
    }


def test_a_run_that_was_cut_off_says_what_is_lost_and_that_the_rest_is_used(tmp_path, caplog):
    path = tmp_path / "run.mcap"
    with BagWriter(path, chunk_bytes=2000) as bag:
        for i, text in enumerate(texts(20)):
            bag.write_string("/scene_graph", i, text)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    run = Run(path)
    with caplog.at_level(logging.WARNING, "semloc_core"):
        found = sum(message.text is not None for message in run)
    assert 0 < found < 20
    said = re.search(r"is cut off: its last ([\d,]+) bytes, all that follows its last whole chunk, can't", caplog.text)
    assert said is not None
    lost = int(said[1].replace(",", ""))
    assert 0 < lost < len(raw) // 2
    path.write_bytes(raw[: len(raw) // 2 - lost])
    assert sum(message.text is not None for message in Run(path)) == found, "what is lost has no message in it"
    assert f"; the {found} messages before are used" in caplog.text
    path.write_bytes(raw[:500])
    with pytest.raises(BagError, match=r"run\.mcap, cut off before its first chunk ends\)$"):
        Run(path)


def test_a_folder_that_holds_a_map_or_nothing_is_no_bag(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "home.map").write_bytes(b"SQLite format 3\x00" + bytes(52) + b"SEML" + bytes(100))
    for folder in (tmp_path / "folder", tmp_path / "folder" / "home.map"):
        with pytest.raises(BagError, match=r"^expected a (bag|run)[^\n]*\(got [^\n]*\)$") as refused:
            Run(folder)
        assert "storage" not in str(refused.value)
    assert "which is a map" in str(refused.value)


def test_zeros_from_within_a_chunk_on_are_a_run_that_was_cut_off(tmp_path):
    path = tmp_path / "run.mcap"
    with BagWriter(path, chunk_bytes=2000) as bag:
        for i, text in enumerate(texts(20)):
            bag.write_string("/scene_graph", i, text)
    raw = path.read_bytes()
    whole = [m.data for m in read_messages(path)]
    counts = set()
    for size in range(1000, len(raw) - 1000, 701):
        path.write_bytes(raw[:size] + bytes(len(raw) - size))
        found = [m.data for m in read_messages(path)]
        assert found == whole[: len(found)]
        counts.add(len(found))
    assert len(counts) > 5


@pytest.mark.parametrize("name", ["run.mcap.zstd", "run_without_suffix"])
def test_a_bag_compressed_as_a_whole_is_read_by_all(tmp_path, name):
    raw = write(tmp_path / "run.mcap").read_bytes()
    (tmp_path / name).write_bytes(zstandard.ZstdCompressor().compress(raw))
    assert is_run(tmp_path / name)
    assert len(list(read_run(tmp_path / name))) == 6
    assert graph_at_end(tmp_path / name).places == graph_at_end(tmp_path / "run.mcap").places


def test_a_folder_without_metadata_is_read_in_the_order_of_its_files(tmp_path):
    (tmp_path / "run").mkdir()
    for number, text in zip((9, 10), texts(2), strict=True):
        with BagWriter(tmp_path / "run" / f"run_{number}.mcap") as bag:
            bag.write_string("/scene_graph", number, text)
    assert [item.text for item in read_run(tmp_path / "run")] == texts(2)


def test_json_text_with_an_update_a_line_is_a_run(tmp_path):
    path = tmp_path / "notes"
    path.write_text("\ufeff" + "\n\n".join(texts(3)) + "\n")
    assert is_run(path)
    assert [(item.text, item.stamp_ns) for item in read_run(path)] == [
        (t, (i + 1) * STEP_NS) for i, t in enumerate(texts(3))
    ]
    assert graph_at_end(path).places == SceneGraph.from_update(UPDATE).places
    (tmp_path / "graph.json").write_text('{"nodes": [], "edges": []}')
    assert not is_run(tmp_path / "graph.json")
    with pytest.raises(BagError, match=r"which is a scene graph; semloc bag simulate walks through one\)$"):
        Run(tmp_path / "graph.json")


def hydra_bag(path, contents=b"nonsense"):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(DSG_FIELDS, DSG))
    types, none = store.types, np.array([], np.uint64)
    with path.open("wb") as file:
        bag = Writer(file)
        bag.start("ros2", "test")
        channel = bag.register_channel(
            "/hydra/backend/dsg", "cdr", bag.register_schema(DSG, "ros2msg", DSG_FIELDS.encode())
        )
        for i in range(2):
            stamp = types["builtin_interfaces/msg/Time"](100 + i, 5)
            header = types["std_msgs/msg/Header"](stamp, "hydra_map")
            message = types[DSG](header, np.frombuffer(contents, np.uint8), none, none, True, i)
            bag.add_message(channel, i, bytes(store.serialize_cdr(message, DSG)), i)
        bag.finish()
    return path


def test_a_bag_of_hydras_own_messages_is_a_run(tmp_path):
    spark_dsg = pytest.importorskip("spark_dsg")
    graph = spark_dsg.DynamicSceneGraph()
    for i in range(3):
        place = spark_dsg.PlaceNodeAttributes()
        place.position = [float(i), 0.0, 0.0]
        graph.add_node(spark_dsg.DsgLayers.PLACES, spark_dsg.NodeSymbol("p", i).value, place)
    robot = spark_dsg.AgentNodeAttributes()
    robot.position, robot.world_R_body = [1.9, 0.0, 0.0], spark_dsg.Quaternion(1.0, 0.0, 0.0, 0.0)
    graph.add_node(spark_dsg.DsgLayers.AGENTS, spark_dsg.NodeSymbol("a", 0).value, robot)
    path = hydra_bag(tmp_path / "run.mcap", graph.to_binary())
    items = list(read_run(path))
    assert [item.stamp_ns for item in items] == [100_000_000_005, 101_000_000_005]
    first = wire.decode_update(items[0].text)
    assert (first.full, first.frame_id, len(first.places)) == (True, "hydra_map", 3)
    assert first.query_place == str(spark_dsg.NodeSymbol("p", 2).value)
    assert graph_at_end(path).places[first.query_place] == (2.0, 0.0, 0.0)


def test_without_spark_dsg_hydras_bag_says_what_to_install(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "spark_dsg", None)
    with pytest.raises(BagError, match=r"spark_dsg.*pip install 'semloc\[hydra\]'"):
        list(read_run(hydra_bag(tmp_path / "run.mcap")))
