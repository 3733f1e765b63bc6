"""The Hydra reader on hand-made files; `test_hydra_write` has the real ones."""

import json
import logging
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.errors import ConfigError, FileFormatError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.sources.hydra import AgentPose, Room, node_id, read_hydra
from semloc_core.wire import Object

P = [int(node_id("p", i)) for i in range(4)]
OBJ = [int(node_id("O", i)) for i in range(3)]
R, A = int(node_id("R", 0)), int(node_id("a", 0))


def place(i, position=(0.0, 0.0, 0.0)):
    return {"id": i, "layer": 3, "attributes": {"type": "PlaceNodeAttributes", "position": list(position)}}


def thing(i, label=5, position=(0.0, 0.0, 0.0), box=None):
    attributes = {"type": "ObjectNodeAttributes", "position": list(position), "semantic_label": label}
    return {"id": i, "layer": 2, "attributes": attributes | ({"bounding_box": box} if box else {})}


def room(i, name="R(0)"):
    attributes = {"type": "RoomNodeAttributes", "position": [1, 2, 3], "name": name}
    return {"id": i, "layer": 4, "attributes": attributes}


def agent(i, stamp, position=(0.0, 0.0, 0.0), rotation=(1.0, 0.0, 0.0, 0.0)):
    attributes = {
        "type": "AgentNodeAttributes",
        "position": list(position),
        "world_R_body": dict(zip("wxyz", rotation, strict=True)),
    }
    return {"id": i, "layer": 2, "timestamp": stamp, "attributes": attributes}


def save(path, nodes, edges=(), **more):
    document = {"nodes": nodes, "edges": [{"source": a, "target": b} for a, b in edges]} | more
    path.write_text(json.dumps(document))
    return path


@pytest.fixture
def file(tmp_path):
    return tmp_path / "graph.json"


def refused(path, *words):
    with pytest.raises(FileFormatError) as caught:
        read_hydra(path)
    line = str(caught.value)
    assert line.startswith("expected ")
    assert len(line.splitlines()) == 1
    for word in words:
        assert word in line, line


def test_layers_are_told_apart_by_type(file):
    """1.0 keeps agents in layer 2, beside the objects."""
    nodes = [place(P[0], (1, 2, 3)), place(P[1]), thing(OBJ[0]), agent(A, 7, (4, 5, 6)), room(R, "kitchen")]
    read = read_hydra(save(file, nodes, [(P[1], P[0]), (P[0], OBJ[0]), (P[1], A), (R, P[1]), (R, P[0])]))
    a, b = str(P[0]), str(P[1])
    assert read.graph.places == {a: (1.0, 2.0, 3.0), b: (0.0, 0.0, 0.0)}
    assert read.graph.objects == {str(OBJ[0]): Object(str(OBJ[0]), "class_5", (0.0, 0.0, 0.0))}
    assert set(read.graph.neighbours[a]) == {b}
    assert read.graph.parents == {str(OBJ[0]): {a}}
    assert read.agents == [AgentPose(7, (4.0, 5.0, 6.0), (0.0, 0.0, 0.0, 1.0), str(A), b)]
    assert read.rooms == {str(R): Room("kitchen", (1.0, 2.0, 3.0), (a, b))}
    assert read.dropped == {}
    assert read.reversed == 0
    assert read.frame_id == "map"


def test_what_is_broken_is_dropped_counted_and_said(file, caplog):
    nodes = [
        place(P[0]), place(P[1]), place(P[0], (9, 9, 9)), place(P[2], (float("nan"), 0, 0)),
        place(P[3], (None, 0, 0)), thing(OBJ[0]), thing(OBJ[1], position=(0, float("inf"), 0)),
        thing(OBJ[2], position=(1e12, 0, 0)), agent(A, 2**70), agent(A + 1, 1, rotation=(0, 0, 0, 0)),
    ]  # fmt: skip
    edges = [
        (P[0], P[1]), (P[1], P[0]), (P[0], P[1]), (P[0], P[0]), (P[0], P[2]), (P[0], 12345), (OBJ[0], P[0]),
    ]  # fmt: skip
    with caplog.at_level(logging.INFO):
        read = read_hydra(save(file, nodes, edges))
    assert read.dropped == {
        "dangling edge": 2,
        "duplicate edge": 2,
        "duplicate node id": 1,
        "non-finite position": 3,
        "orientation that is no rotation": 1,
        "position out of range": 1,
        "self-loop": 1,
        "time out of range": 1,
    }
    assert read.reversed == 1
    assert read.graph.places == {str(P[0]): (0.0, 0.0, 0.0), str(P[1]): (0.0, 0.0, 0.0)}
    assert read.graph.parents == {str(OBJ[0]): {str(P[0])}}
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "graph.json: dropped 2 × dangling edge" in record.message
    assert "1 reversed" in record.message


def test_edges_from_child_to_parent_are_turned_round(file):
    nodes = [place(P[0]), thing(OBJ[0]), room(R), agent(A, 0)]
    read = read_hydra(save(file, nodes, [(OBJ[0], P[0]), (P[0], R), (A, P[0])]))
    assert read.reversed == 3
    assert read.graph.children == {str(P[0]): {str(OBJ[0])}}
    assert read.rooms[str(R)].places == (str(P[0]),)
    assert read.agents[0].place == str(P[0])


def test_agents_come_by_time(file):
    nodes = [agent(A + 2, 5), agent(A, 9), agent(A + 1, 5)]
    later = agent(A + 3, None)
    later["attributes"]["timestamp"] = 7  # where 1.1 keeps it
    read = read_hydra(save(file, [*nodes, later]))
    assert [(a.stamp_ns, int(a.id) - A) for a in read.agents] == [(5, 1), (5, 2), (7, 3), (9, 0)]


@pytest.mark.parametrize(
    ("box", "size"),
    [
        ({"type": "AABB", "min": [0, 1, 2], "max": [1, 3, 5]}, (1.0, 2.0, 3.0)),
        ({"type": "AABB", "dimensions": [1, 2, 3]}, (1.0, 2.0, 3.0)),
        ({"type": "INVALID", "min": [0, 0, 0], "max": [0, 0, 0]}, None),
        ({"type": "AABB", "min": [1, 1, 2], "max": [0, 3, 5]}, None),
        ({"type": "AABB", "dimensions": [1, None, 3]}, None),
        ({"type": "AABB"}, None),
        (None, None),
    ],
)
def test_sizes_of_both_versions(file, box, size):
    read = read_hydra(save(file, [thing(OBJ[0], box=box)]))
    assert read.graph.objects[str(OBJ[0])].size == size


def test_a_files_names_come_before_a_labelspaces_ids(file):
    """Ids mean other things in other labelspaces: what a file calls a thing is not to be overruled."""
    space = Labelspace("x", ("bird", "lamp"), ids={"bird": (5,), "lamp": (6,)})
    names = {"metadata": {"labelspaces": {"_l2p0": [[5, "chair"], [6, "class_6"]]}}}
    nodes = [thing(OBJ[0], 5), thing(OBJ[1], 6), thing(OBJ[2], 7)]

    def classes(read):
        return [read.graph.objects[str(i)].class_ for i in OBJ]

    assert classes(read_hydra(save(file, nodes, **names))) == ["chair", "class_6", "class_7"]
    assert classes(read_hydra(file, space)) == ["chair", "lamp", "class_7"]
    assert read_hydra(file).labelspace.classes == ("chair", "class_6")
    assert classes(read_hydra(save(file, nodes), space)) == ["bird", "lamp", "class_7"]
    assert read_hydra(file, space).labelspace.classes == ("class_5", "class_6", "class_7")


def test_an_empty_graph_is_a_graph(file):
    read = read_hydra(save(file, []))
    assert read.graph.places == {}
    assert len(read.labelspace) == 0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "truncated"),
        ('{"nodes": [', "truncated"),
        ("{}", "`nodes`"),
        ('{"nodes": []}', "`edges`"),
        ("[]", "array"),
        ('{"nodes": 3, "edges": []}', "$.nodes"),
        ('{"nodes": [{"id": "kitchen", "attributes": {"type": "x"}}], "edges": []}', "64 bits (got kitchen)"),
        ('{"nodes": [{"id": -1, "attributes": {"type": "x"}}], "edges": []}', "64 bits (got -1)"),
        ('{"nodes": [{"id": 18446744073709551616, "attributes": {"type": "x"}}], "edges": []}', "64 bits"),
        ('{"nodes": [{"id": 1}], "edges": []}', "`attributes`"),
        ('{"nodes": [], "edges": [{"source": 1}]}', "`target`"),
        (
            '{"nodes": [], "edges": [], "SPARK_DSG_header": {"version": {"major": 2, "minor": 3}}}',
            "(got 2.3)",
        ),
        ('{"x": ' + "[" * 100_000, "recursion"),
        ('{"nodes": [], "edges": [], "metadata": {"labelspaces": {"_l2p0": [["chair", 1]]}}}', "labelspaces"),
    ],
)
def test_what_is_no_scene_graph_is_refused_in_one_line(file, text, word):
    file.write_text(text)
    refused(file, "graph.json", word)


def test_missing_keys_of_a_node_are_named(file):
    nameless = thing(OBJ[0])
    del nameless["attributes"]["semantic_label"]
    refused(save(file, [nameless]), "semantic_label", str(OBJ[0]))
    timeless = agent(A, None)
    refused(save(file, [timeless]), "timestamp", str(A))


def test_files_that_are_not_there_or_not_text(file, tmp_path):
    refused(file, "No such file")
    refused(tmp_path, "directory")
    file.write_bytes(b"\xff\xfe\x00")
    refused(file, "graph.json")


def test_a_file_beyond_the_limit_is_not_even_read(file, monkeypatch):
    save(file, [])
    monkeypatch.setattr("semloc_core.sources.hydra.format.MAX_FILE_BYTES", 5)
    refused(file, "at most 5 bytes")


def test_meshes_are_skipped(file):
    more = {"mesh": {"points": [[0, 0, 0]], "faces": None}, "mesh_edges": [{"source": OBJ[0], "target": 3}]}
    assert read_hydra(save(file, [thing(OBJ[0])], **more)).dropped == {}


def test_binary_without_spark_dsg_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "spark_dsg", None)
    refused(tmp_path / "x.sparkdsg", "spark_dsg", "pip install")


@settings(max_examples=60)
@given(st.data())
def test_mutated_files_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("fuzz") / "g.json"
    raw = bytearray(json.dumps({"nodes": [place(P[0]), thing(OBJ[0]), agent(A, 1)], "edges": []}).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path.write_bytes(raw)
    line = "read"
    try:
        read_hydra(path)
    except FileFormatError as error:
        line = str(error)
    assert len(line.splitlines()) == 1


def said(read):
    return " | ".join(read.said)


def test_objects_without_a_place_hang_on_the_nearest_in_reach(file):
    nodes = [place(P[0]), place(P[1], (3, 0, 0)), thing(OBJ[0], position=(2, 0, 1)), thing(OBJ[1], position=(90, 0, 0))]
    read = read_hydra(save(file, nodes, [(P[0], P[1])]))
    assert read.graph.parents == {str(OBJ[0]): {str(P[1])}, str(OBJ[1]): set()}
    assert "2 objects without an edge to a place: 1 now hangs on the nearest one, 1 is more than 4 m" in said(read)
    assert f"class_5 {OBJ[1]}" in said(read)


def test_objects_on_2d_places_hang_on_3d_ones(file):
    flat = place(P[3], (0, 0, 0))
    flat["attributes"]["type"] = "Place2dNodeAttributes"
    read = read_hydra(save(file, [place(P[0]), flat, thing(OBJ[0], position=(1, 0, 0))], [(P[3], OBJ[0])]))
    assert read.graph.parents == {str(OBJ[0]): {str(P[0])}}
    assert said(read) == "1 object on 2D places: 1 now hangs on the nearest one"


def test_parts_without_an_edge_between_are_said_with_their_sizes(file):
    nodes = [place(P[0]), place(P[1]), place(P[2]), thing(OBJ[0])]
    read = read_hydra(save(file, nodes, [(P[0], P[1]), (P[0], OBJ[0])]))
    assert said(read) == "the places are in 2 parts without an edge between, of 2, 1 places"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks_and_what_stands_behind_the_end_are_passed_over(file, encoding):
    text = save(file, [place(P[0]), thing(OBJ[0])], [(P[0], OBJ[0])]).read_text()
    file.write_bytes((text + "\0\0").encode(encoding))
    read = read_hydra(file)
    assert read.graph.parents == {str(OBJ[0]): {str(P[0])}}
    assert "a byte order mark" in said(read)
    assert "2 bytes behind the end" in said(read)


def test_labels_without_a_name_or_with_two_are_passed_over(file):
    names = {"metadata": {"labelspaces": {"_l2p0": [[5, "chair"], [5, "seat"], [0, ""], [6, "lamp"]]}}}
    read = read_hydra(save(file, [place(P[0]), thing(OBJ[0], 5)], [(P[0], OBJ[0])], **names))
    assert read.graph.objects[str(OBJ[0])].class_ == "chair"
    assert read.labelspace.classes == ("chair", "lamp")
    assert "label 5 has two names in _l2p0: 'chair' is taken, 'seat' passed over" in said(read)
    assert "1 label(s) without a name in _l2p0 passed over" in said(read)


def test_names_of_the_objects_own_partition_come_before_those_of_another(file):
    spaces = {"metadata": {"labelspaces": {"_l2p1": [[5, "chair"]], "_l2p2": [[5, "sofa"]]}}}
    nodes = [place(P[0])] + [thing(i, 5) | {"partition": n} for n, i in enumerate(OBJ)]
    read = read_hydra(save(file, nodes, [(P[0], i) for i in OBJ], **spaces))
    assert [read.graph.objects[str(i)].class_ for i in OBJ] == ["chair", "chair", "sofa"]
    assert set(read.labelspace.classes) == {"chair", "sofa"}
    assert "those of labelspace _l2p1 are taken" in said(read)


def test_symbols_and_numbers_as_text_are_ids(file):
    nodes = [place("p(0)"), place(str(P[1]), (1, 0, 0)), thing("O(0)", "5"), thing("O1", 5.0)]
    read = read_hydra(save(file, nodes, [("p(0)", P[1]), ("p(0)", "O(0)"), (str(P[1]), "O(1)")]))
    assert set(read.graph.places) == {str(P[0]), str(P[1])}
    assert read.graph.parents == {str(OBJ[0]): {str(P[0])}, str(OBJ[1]): {str(P[1])}}
    assert {thing_.class_ for thing_ in read.graph.objects.values()} == {"class_5"}
    assert read.said == ()


def test_single_nodes_that_can_not_be_read_are_passed_over_and_counted(file):
    broken = [{"id": P[2], "attributes": None}, place(8.070450532247929e18), thing(OBJ[1], None)]
    read = read_hydra(save(file, [place(P[0]), thing(OBJ[0]), *broken], [(P[0], OBJ[0]), (None, P[0])]))
    assert read.dropped == {
        "edge that can't be read": 1,
        "node id that is no 64-bit number": 1,
        "node that can't be read": 1,
        "object without a semantic_label": 1,
    }
    assert set(read.graph.places) == {str(P[0])}


def test_poses_without_a_rotation_keep_their_position_and_robots_are_told_apart(file):
    b = int(node_id("b", 0))
    nodes = [place(P[0]), thing(OBJ[0]), agent(b, 1), agent(A, 2, (1, 2, 3))]
    nodes[3]["attributes"]["world_R_body"] = None
    read = read_hydra(save(file, nodes, [(P[0], OBJ[0])]))
    assert read.robots == ["a", "b"]
    assert read.agents_of() == [AgentPose(2, (1.0, 2.0, 3.0), None, str(A))]
    assert [pose.id for pose in read.agents_of("b")] == [str(b)]
    assert "1 agent pose(s) without a rotation" in said(read)
    with pytest.raises(ConfigError, match="got 'c'; a, b"):
        read.agents_of("c")
