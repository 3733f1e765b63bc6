"""What goes over the wire: strict in, deterministic out, one line for whatever is wrong."""

import json
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.errors import MessageError
from semloc_core.wire import (
    ExplainRequest,
    Match,
    Object,
    Place,
    PlaceMatches,
    SceneGraphUpdate,
    decode,
    decode_update,
    encode,
)
from semloc_core.wire.codec import schema_of

FULL = {
    "schema": "semloc/scene_graph_update/1",
    "stamp_ns": 5,
    "frame_id": "map",
    "seq": 0,
    "full": True,
    "places": [{"id": "p1", "position": [0, 0, 0]}, {"id": "p2", "position": [1, 0, 0]}],
    "objects": [{"id": "o1", "class": "chair", "position": [0, 1, 0]}],
    "edges": [["p1", "p2"], ["p1", "o1"]],
    "query_place": "p1",
}


def text(**changes) -> str:
    return json.dumps(FULL | changes)


def refused(data, *words, **options) -> str:
    with pytest.raises(MessageError) as caught:
        decode_update(data, **options)
    line = str(caught.value)
    assert line.startswith("expected ")
    assert "(got" in line
    assert line.isprintable(), line
    assert len(line) <= 300
    for word in words:
        assert word in line
    return line


def test_a_full_update_is_decoded_from_bytes_and_text():
    update = decode_update(text())
    assert update == decode_update(text().encode())
    assert update.places[1] == Place(id="p2", position=(1.0, 0.0, 0.0))
    assert update.objects == [Object(id="o1", class_="chair", position=(0.0, 1.0, 0.0))]
    assert update.removed_nodes == []


def test_ids_of_64_bits_stay_exact():
    node = str(2**64 - 1)
    update = decode_update(text(places=[{"id": node, "position": [0, 0, 0]}], objects=[], edges=[], query_place=node))
    assert decode_update(encode(update)).places[0].id == node


def test_the_size_limit_is_in_bytes_and_comes_first():
    refused("x" * 11, "at most 10 bytes", "(got 11)", max_bytes=10)
    refused("é" * 10, "(got 20)", max_bytes=10)
    data = text().encode()
    decode_update(data, max_bytes=len(data))
    refused(data, max_bytes=len(data) - 1)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (text()[:-9], "truncated"),
        ("", "truncated"),
        (text() + "x", "trailing"),
        (b"\xff\xfe", "JSON"),
        (text().encode().replace(b"chair", b"ch\xffir"), "utf-8"),
        (text().replace("chair", "ch\ud800ir"), "utf-8"),
        (text().replace("chair", "\\ud800"), "surrogate"),
        ("[" * 1_000_000, "array"),
        ('{"x":' * 1_000_000, "unknown field"),
        (text(places="[]").replace('"[]"', "[" * 200_000), "array"),
        ("null", "null"),
        (text().replace('"seq"', '"s\\neq\\u001b"'), "s\\neq\\x1b"),
        (text(frame_id=None), "$.frame_id"),
    ],
)
def test_text_that_is_no_message_gives_one_line(data, word):
    refused(data, word)


@pytest.mark.parametrize(
    ("schema", "got"),
    [("semloc/scene_graph_update/2", "semloc/scene_graph_update/2"), ("x" * 999, "xxx"), ("a\nb", "a\\nb")],
)
def test_another_schema_is_named_beside_the_expected_one(schema, got):
    refused(text(schema=schema), "semloc/scene_graph_update/1", got)


def test_a_message_without_a_schema_is_told_so():
    missing = {k: v for k, v in FULL.items() if k != "schema"}
    refused(json.dumps(missing), "semloc/scene_graph_update/1", "got none")


def test_a_newer_schema_with_new_fields_is_told_by_its_schema():
    refused(text(schema="semloc/scene_graph_update/2", wings=2), "(got semloc/scene_graph_update/2)")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "1" + "0" * 400, "1e10"])
def test_a_number_that_is_no_length_is_refused(number):
    refused(text().replace("[1, 0, 0]", f"[{number}, 0, 0]"))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"places": FULL["places"] * 2}, "'p1' 2 times"),
        ({"objects": FULL["objects"] * 3}, "'o1' 3 times"),
        ({"objects": [{"id": "p1", "class": "chair", "position": [0, 0, 0]}], "edges": []}, "'p1' 2 times"),
        ({"edges": [["p1", "p1"]]}, "self-loop"),
        ({"edges": [["p1", "p9"]]}, "'p9'"),
        ({"sightings": [["p1", "p1"]]}, "self-loop"),
        ({"sightings": [["o1", "p1"]]}, "[place, object]"),
        ({"sightings": [["p1", "o9"]]}, "'o9'"),
        ({"removed_edges": [["p7", "p7"]]}, "self-loop"),
        ({"query_place": "p9"}, "unknown"),
        ({"query_place": "o1"}, "an object"),
        ({"query_place": ""}, "$.query_place"),
        ({"edges": [["p1", ""]]}, "$.edges[0][1]"),
        ({"odometry": {"position": [0, 0, 0], "orientation_xyzw": [1, 1, 0, 0]}}, "unit quaternion"),
    ],
)
def test_an_update_that_contradicts_itself_is_refused(changes, word):
    refused(text(**changes), word)


def test_objects_are_not_joined():
    objects = [{"id": o, "class": "chair", "position": [0, 0, 0]} for o in ("o1", "o2")]
    refused(text(objects=objects, edges=[["o1", "o2"]]), "place at one end")
    refused(text(objects=objects, edges=[["o1", "o2"]], full=False), "place at one end")


def test_a_delta_may_name_nodes_that_only_the_graph_knows():
    update = decode_update(text(full=False, edges=[["p1", "p9"]], sightings=[["p7", "o7"]], query_place="p8"))
    assert update.query_place == "p8"
    refused(text(full=False, query_place="o1"), "an object")
    refused(text(full=False, sightings=[["o1", "o7"]]), "[place, object]")


def matches(**changes) -> PlaceMatches:
    row = Match(rank=1, map="office", place="p1", position=(0.1234567, -1e-9, -0.0), similarity=1 / 3, probability=1.0)
    fields = {
        "schema": schema_of(PlaceMatches), "stamp_ns": 1, "frame_id": "map", "seq": 1, "query_place": "p1",
        "status": "match", "matches": [row], "raw_matches": None, "rivals": [], "map": None, "model": None,
        "calibrated": False, "latency_ms": None,
    }  # fmt: skip
    return PlaceMatches(**(fields | changes))


def test_floats_are_rounded_and_no_zero_is_negative():
    row = json.loads(encode(matches()))["matches"][0]
    assert row["position"] == [0.123457, 0.0, 0.0]
    assert row["similarity"] == 0.333333
    assert b"-0.0" not in encode(matches())


def test_an_object_without_labels_is_written_as_before_there_were_any():
    """Maps are known by the hash of these bytes."""
    for labels in ({}, {"labels": None}):
        message = decode_update(text(objects=[{"id": "o", "class": "chair", "position": [0, 1, 0]} | labels], edges=[]))
        assert b'"objects":[{"id":"o","class":"chair","position":[0.0,1.0,0.0],"size":null}]' in encode(message)


def test_labels_are_written_by_name_and_can_be_read_again():
    """A detector's distribution over many classes is full of numbers that are rounded to nothing."""
    rest = {f"class {i:03}": 0.4 / 1000 for i in range(1000)} | {"lamp": 1e-9}
    labels = {"labels": 0.3, "chair": 0.3 - 4e-7} | rest
    thing = {"id": "o", "class": "chair", "position": [0, 1, 0], "labels": labels}
    message = decode_update(text(objects=[thing], edges=[]))
    written = encode(message)
    again = decode_update(written)
    assert again.objects[0].labels == {"chair": 0.3, "labels": 0.3} | {name: 0.0004 for name in rest if name != "lamp"}
    assert encode(again) == written
    turned = decode_update(text(objects=[thing | {"labels": dict(reversed(labels.items()))}], edges=[]))
    assert encode(turned) == written
    faint = decode_update(text(objects=[thing | {"labels": {"chair": 1e-9}}], edges=[]))
    assert decode_update(encode(faint)).objects[0].labels is None


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float32("-inf")])
def test_nan_and_infinity_do_not_get_out(value):
    with pytest.raises(MessageError, match="finite"):
        encode(matches(latency_ms=value))


def test_numpy_scalars_get_out_as_numbers():
    assert encode(matches(latency_ms=np.float32(0.5), seq=np.int64(1))) == encode(matches(latency_ms=0.5))


@pytest.mark.parametrize("value", [object(), "\ud800"])
def test_what_json_can_not_hold_is_refused(value):
    with pytest.raises(MessageError, match="JSON can hold"):
        encode(matches(frame_id=value))


def test_output_is_compact_and_in_the_order_of_the_fields():
    request = ExplainRequest(schema=schema_of(ExplainRequest), stamp_ns=1, frame_id="", seq=2)
    assert encode(request) == (
        b'{"schema":"semloc/explain_request/1","stamp_ns":1,"frame_id":"","seq":2,'
        b'"query_place":null,"map":null,"place":null,"methods":null}'
    )
    assert decode(encode(request), ExplainRequest) == request


ids = st.text(min_size=1, max_size=8).filter(lambda s: s.isascii())
lengths = st.floats(-1e9, 1e9).map(lambda x: round(x, 6) + 0.0)
positions = st.tuples(lengths, lengths, lengths)


@settings(max_examples=50)
@given(st.dictionaries(ids, positions, max_size=6), st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**63 - 1))
def test_what_is_encoded_is_decoded_again(places, stamp, seq):
    update = SceneGraphUpdate(
        schema=schema_of(SceneGraphUpdate), stamp_ns=stamp, frame_id="map", seq=seq, full=True, objects=[], edges=[],
        places=[Place(id=i, position=p) for i, p in places.items()], query_place=next(iter(places), None),
    )  # fmt: skip
    assert decode_update(encode(update)) == update
    assert encode(decode_update(encode(update))) == encode(update)


@settings(max_examples=200)
@given(st.data())
def test_mutated_text_is_decoded_or_refused_in_one_line(data):
    raw = bytearray(text().encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    line = "accepted"
    try:
        decode_update(bytes(raw))
    except MessageError as error:
        line = str(error)
    assert line.isprintable()


def test_the_wire_needs_no_torch():
    code = "import sys, semloc_core.wire.codec; sys.exit(any(m in sys.modules for m in ('torch', 'scipy', 'rclpy')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def delta_of_30_nodes() -> bytes:
    places = [{"id": str(8070450532247928832 + i), "position": [0.1 * i, 1.0, 2.0]} for i in range(20)]
    objects = [
        {
            "id": str(5692549928996306944 + i),
            "class": "chair",
            "position": [0.1 * i, 1.0, 2.0],
            "size": [1, 1, 1],
        }
        for i in range(10)
    ]
    edges = [[a["id"], b["id"]] for a, b in zip(places, places[1:] + objects[:1], strict=True)]
    return text(full=False, places=places, objects=objects, edges=edges, query_place=None).encode()


def test_decoding_costs_little_beside_plain_json_parsing():
    """A rule that costs n² of the nodes, or a decoder built anew for each message, would show here."""
    import timeit

    data = delta_of_30_nodes()
    plain = min(timeit.repeat(lambda: msgspec.json.decode(data), number=200, repeat=5))
    strict = min(timeit.repeat(lambda: decode_update(data), number=200, repeat=5))
    assert strict < 10 * plain


def test_benchmark_decode(benchmark):
    data = delta_of_30_nodes()
    benchmark(decode_update, data)
