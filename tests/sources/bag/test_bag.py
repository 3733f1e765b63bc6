"""Bags against the oracles: rosbags and the mcap library read what we write, we read what they write."""

import logging
import random
import struct
import tracemalloc
import zlib
from pathlib import Path

import pytest
import yaml
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from semloc_core.errors import BagError
from semloc_core.sources.bag import (
    POINT_STAMPED,
    STRING,
    BagReader,
    BagWriter,
    decode_point,
    decode_string,
    encode_point,
    encode_string,
    read_messages,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
MESSAGES = [(i * 1000 + 5, f'{{"seq": {i}, "é": "{"x" * (i % 50)}"}}', (i / 3, -i, 0.5)) for i in range(200)]
START = b"\x89MCAP0\r\n"


def write(path, compression="none", chunk_bytes=2048, messages=MESSAGES):
    with BagWriter(path, compression=compression, chunk_bytes=chunk_bytes) as bag:
        for stamp, text, position in messages:
            bag.write_string("/scene_graph", stamp, text)
            bag.write_point("/ground_truth", stamp, "map", position)
    return path


def expected(messages=MESSAGES):
    for stamp, text, position in messages:
        yield ("/scene_graph", STRING, stamp, text)
        yield ("/ground_truth", POINT_STAMPED, stamp, (stamp, "map", position))


def decoded(messages):
    for m in messages:
        assert m.stamp_ns == m.publish_ns
        value = decode_string(m.data) if m.type == STRING else tuple(decode_point(m.data))
        yield (m.topic, m.type, m.stamp_ns, value)


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value):
    return struct.pack("<I", len(value)) + value


def chunk(data, *, claimed=None, compression=b"", crc=0, stored=None):
    stored = data if stored is None else stored
    head = struct.pack("<QQQI", 0, 1, len(data) if claimed is None else claimed, crc)
    return record(6, head + text(compression) + struct.pack("<Q", len(stored)) + stored)


SCHEMA = record(3, struct.pack("<H", 1) + text(STRING.encode()) + text(b"ros2msg") + text(b"string data\n"))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text(b"/s") + text(b"cdr") + struct.pack("<I", 0))
MESSAGE = record(5, struct.pack("<HIQQ", 1, 0, 7, 7) + encode_string("hello"))
HEADER = record(1, text(b"ros2") + text(b"test"))
DATA_END = record(15, bytes(4))
FOOTER = record(2, bytes(20)) + START


# --- CDR ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["", "a", "abc", "abcd", "größe 図", "x" * 10_000])
def test_string_is_byte_for_byte_what_rosbags_makes_and_reads_in_both_byte_orders(value):
    message = STORE.types[STRING](data=value)
    assert encode_string(value) == bytes(STORE.serialize_cdr(message, STRING)) == encode_string(value.encode())
    for little in (True, False):
        assert decode_string(bytes(STORE.serialize_cdr(message, STRING, little_endian=little))) == value
    assert decode_string(encode_string(value) + bytes(3)) == value


@pytest.mark.parametrize("frame", ["", "map", "a/longer_frame"])
def test_point_is_byte_for_byte_what_rosbags_makes_and_reads_in_both_byte_orders(frame):
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=12, nanosec=345), frame_id=frame
    )
    message = types[POINT_STAMPED](header=header, point=types["geometry_msgs/msg/Point"](x=1.5, y=-2.0, z=3.25))
    stamp, position = 12 * 10**9 + 345, (1.5, -2.0, 3.25)
    assert encode_point(stamp, frame, position) == bytes(STORE.serialize_cdr(message, POINT_STAMPED))
    for little in (True, False):
        cdr = bytes(STORE.serialize_cdr(message, POINT_STAMPED, little_endian=little))
        assert decode_point(cdr) == (stamp, frame, position)


@pytest.mark.parametrize(
    "cdr",
    [
        b"",
        b"\x00\x01\x00",
        b"\x00\x01\x00\x00",
        b"\x00\x02\x00\x00\x02\x00\x00\x00a\x00",
        b"\x01\x01\x00\x00\x02\x00\x00\x00a\x00",
        b"\x00\x01\x00\x00\xff\xff\xff\xffa\x00",
        b"\x00\x01\x00\x00\x03\x00\x00\x00a\x00",
        b"\x00\x01\x00\x00\x02\x00\x00\x00ab",
        b"\x00\x01\x00\x00\x02\x00\x00\x00\xff\x00",
        b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00" + bytes(4),
    ],
)
def test_malformed_string_is_one_line(cdr):
    with pytest.raises(BagError, match=r"^expected [^\n]* \(got [^\n]*\)$"):
        decode_string(cdr)


def test_point_cut_anywhere_is_refused():
    cdr = encode_point(10**18, "map", (1.0, 2.0, 3.0))
    for end in range(len(cdr)):
        with pytest.raises(BagError):
            decode_point(cdr[:end])


# --- what we write -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_we_read_what_we_wrote(tmp_path, name, compression):
    path = write(tmp_path / name, compression)
    reader = BagReader(path)
    assert list(decoded(reader)) == list(expected())
    assert reader.types == {"/scene_graph": STRING, "/ground_truth": POINT_STAMPED}
    assert not reader.truncated
    assert reader.unordered == 0
    only = list(decoded(read_messages(path, ["/ground_truth"])))
    assert only == [m for m in expected() if m[0] == "/ground_truth"]


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_rosbags_reads_our_folder(tmp_path, compression):
    path = write(tmp_path / "run", compression)
    with Reader(path) as reader:
        assert reader.message_count == 2 * len(MESSAGES)
        assert reader.start_time == MESSAGES[0][0]
        assert reader.end_time == MESSAGES[-1][0] + 1
        for connection in reader.connections:
            assert connection.digest == STORE.hash_rihs01(connection.msgtype)
            (qos,) = connection.ext.offered_qos_profiles
            assert isinstance(qos, Qos)
            assert (qos.history.name, qos.depth, qos.reliability.name) == ("KEEP_LAST", 1000, "RELIABLE")
    with AnyReader([path]) as reader:
        texts = [
            reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages() if c.topic == "/scene_graph"
        ]
    assert texts == [t for _, t, _ in MESSAGES]


def test_rosbags_reads_our_bare_file(tmp_path):
    path = write(tmp_path / "run.mcap")
    with AnyReader([path]) as reader:
        points = [
            (t, reader.deserialize(raw, c.msgtype).point.x)
            for c, t, raw in reader.messages()
            if c.topic == "/ground_truth"
        ]
    assert points == [(stamp, position[0]) for stamp, _, position in MESSAGES]


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_mcap_library_reads_our_file_with_crc_checks_and_by_index(tmp_path, compression):
    path = write(tmp_path / "run.mcap", compression)
    with path.open("rb") as stream:
        assert sum(1 for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages()) == 2 * len(MESSAGES)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 2 * len(MESSAGES)
        assert len(summary.chunk_indexes) > 3
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            assert summary.schemas[channel.schema_id].encoding == "ros2msg"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert qos["reliability"] == "reliable"
        stamps = [m.log_time for _, c, m in reader.iter_messages(topics=["/scene_graph"])]
    assert stamps == [stamp for stamp, _, _ in MESSAGES]


def test_metadata_has_all_fields_that_jazzy_decodes(tmp_path):
    path = write(tmp_path / "run")
    text = (path / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    # rosbag2_storage/yaml.hpp, convert<BagMetadata>::decode reads each of these without a default.
    assert set(information) == {
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "relative_file_paths",
        "compression_format",
        "compression_mode",
        "files",
        "custom_data",
        "ros_distro",
    }
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["run_0.mcap"]
    assert "&id" not in text
    assert [p.name for p in sorted(path.iterdir())] == ["metadata.yaml", "run_0.mcap"]


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_same_messages_give_the_same_bytes(tmp_path, compression):
    first, second = (write(tmp_path / f"{name}.mcap", compression).read_bytes() for name in "ab")
    assert first == second


def test_a_killed_writer_leaves_its_chunks_readable(tmp_path, caplog):
    bag = BagWriter(tmp_path / "run.mcap", chunk_bytes=2048)
    for stamp, value, _ in MESSAGES:
        bag.write_string("/s", stamp, value)
    # Nothing was closed or flushed by hand: this is what another process, or this one's successor, sees.
    reader = BagReader(tmp_path / "run.mcap")
    with caplog.at_level(logging.WARNING, "semloc_core"):
        found = [decode_string(m.data) for m in reader]
    assert reader.truncated
    assert "cut off" in caplog.text
    assert found == [v for _, v, _ in MESSAGES][: len(found)]
    assert len(found) > len(MESSAGES) - 2048 // 40
    bag.close()
    bag.close()
    assert len(list(read_messages(tmp_path / "run.mcap"))) == len(MESSAGES)


def test_messages_are_copied_from_bag_to_bag_as_they_are(tmp_path):
    source = write(tmp_path / "run.mcap")
    with BagWriter(tmp_path / "copy.mcap", chunk_bytes=2048) as bag:
        bag.write("/late", STRING, 9, encode_string("a"), publish_ns=4)
        for message in read_messages(source):
            bag.write_raw(message)
    first, *rest = read_messages(tmp_path / "copy.mcap")
    assert (first.stamp_ns, first.publish_ns) == (9, 4)
    assert rest == list(read_messages(source))


def test_an_error_in_the_with_block_still_closes_the_bag(tmp_path):
    def interrupted():
        with BagWriter(tmp_path / "run") as bag:
            bag.write_string("/s", 1, "a")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 1


def test_bag_without_messages(tmp_path):
    for name in ("run.mcap", "run"):
        BagWriter(tmp_path / name).close()
        assert list(read_messages(tmp_path / name)) == []
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 0


def test_writer_refuses(tmp_path):
    bag = BagWriter(tmp_path / "run.mcap")
    bag.write_string("/s", 1, "a")
    with pytest.raises(BagError, match="2\\^63"):
        bag.write_string("/s", -1, "a")
    with pytest.raises(BagError, match="on /s as before"):
        bag.write_point("/s", 1, "map", (0.0, 0.0, 0.0))
    with pytest.raises(BagError, match="a message type of ROS 2"):
        bag.write("/t", "no_msgs/msg/Such", 1, b"")
    with pytest.raises(BagError, match="32-bit seconds"):
        bag.write_point("/p", 2**62, "map", (0.0, 0.0, 0.0))
    bag.close()
    assert [m.topic for m in read_messages(tmp_path / "run.mcap")] == ["/s"]
    with pytest.raises(BagError, match="closed"):
        bag.write_string("/s", 2, "a")
    with pytest.raises(BagError, match="can be written"):
        BagWriter(tmp_path / "no" / "such" / "run.mcap")
    with pytest.raises(BagError, match="new or empty folder"):
        BagWriter(tmp_path)
    with pytest.raises(BagError, match="none, zstd or lz4"):
        BagWriter(tmp_path / "b.mcap", compression="gzip")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk_is_one_line(tmp_path):
    (tmp_path / "run.mcap").symlink_to("/dev/full")
    bag = BagWriter(tmp_path / "run.mcap", chunk_bytes=10)
    with pytest.raises(BagError, match="room for a bag"):
        bag.write_string("/s", 1, "a" * 100)
    with pytest.raises(BagError, match="room for a bag"):
        bag.close()


# --- what others write -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ],
)
def test_we_read_what_rosbags_writes(tmp_path, version, plugin, mode):
    bag = Rosbag2Writer(tmp_path / "run", version=version, storage_plugin=plugin)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        strings = bag.add_connection("/scene_graph", STRING, typestore=STORE)
        points = bag.add_connection("/ground_truth", POINT_STAMPED, typestore=STORE)
        for stamp, value, position in MESSAGES:
            bag.write(strings, stamp, encode_string(value))
            bag.write(points, stamp, encode_point(stamp, "map", position))
    topics = {"/scene_graph": STRING, "/ground_truth": POINT_STAMPED}
    assert list(decoded(read_messages(tmp_path / "run", topics))) == list(expected())
    assert list(read_messages(tmp_path / "run", ["/other"])) == []
    with pytest.raises(BagError, match=f"expected {POINT_STAMPED} on /scene_graph"):
        list(read_messages(tmp_path / "run", {"/scene_graph": POINT_STAMPED}))


@pytest.mark.parametrize("chunked", [True, False])
def test_we_read_what_the_mcap_library_writes(tmp_path, chunked):
    with (tmp_path / "run.mcap").open("wb") as stream:
        bag = Writer(
            stream,
            chunk_size=512,
            compression=CompressionType.LZ4,
            use_chunking=chunked,
            enable_data_crcs=True,
        )
        bag.start("ros2", "test")
        schema = bag.register_schema(STRING, "ros2msg", b"string data\n")
        channel = bag.register_channel("/s", "cdr", schema)
        bag.add_attachment(0, 0, "picture", "image/png", bytes(3_000_000))
        for stamp, value, _ in MESSAGES:
            bag.add_message(channel, stamp, encode_string(value), stamp + 1)
        bag.finish()
    found = [(m.stamp_ns, m.publish_ns, decode_string(m.data)) for m in read_messages(tmp_path / "run.mcap")]
    assert found == [(stamp, stamp + 1, value) for stamp, value, _ in MESSAGES]
    raw = bytearray((tmp_path / "run.mcap").read_bytes())
    raw[100_000] ^= 1  # in the attachment: only the CRC of the data section covers it
    (tmp_path / "bad.mcap").write_bytes(raw)
    with pytest.raises(BagError, match="data of CRC"):
        list(read_messages(tmp_path / "bad.mcap"))


def test_split_recording_is_read_in_the_order_of_its_metadata(tmp_path):
    folder = write(tmp_path / "run", messages=MESSAGES[:50])
    parts = [MESSAGES[50:120], MESSAGES[120:]]
    for i, part in enumerate(parts):
        # Names whose sorted order is not the order of recording; an old version's path leads with the folder's name.
        write(tmp_path / "part.mcap", messages=part).rename(folder / f"a_{9 - i}.mcap")
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    names = ["run/run_0.mcap", "a_9.mcap", "a_8.mcap"]
    document["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (folder / "metadata.yaml").write_text(yaml.safe_dump(document))
    assert list(decoded(read_messages(folder))) == list(expected())
    (folder / "a_8.mcap").unlink()
    with pytest.raises(BagError, match=r"expected a_8\.mcap in"):
        read_messages(folder)


def test_messages_out_of_order_are_given_as_written_and_counted(tmp_path):
    with BagWriter(tmp_path / "run.mcap") as bag:
        for stamp in (5, 3, 9, 8):
            bag.write_string("/s", stamp, str(stamp))
    reader = BagReader(tmp_path / "run.mcap")
    assert [m.stamp_ns for m in reader] == [5, 3, 9, 8]
    assert reader.unordered == 2


# --- broken files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_file_cut_anywhere_gives_a_prefix_up_to_its_last_whole_chunk(tmp_path, compression):
    whole = write(tmp_path / "run.mcap", compression, messages=MESSAGES[:120]).read_bytes()
    everything = list(read_messages(tmp_path / "run.mcap"))
    with (tmp_path / "run.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    ends = [c.chunk_start_offset + c.chunk_length for c in chunks]
    last = 0
    for size in [*range(len(START), len(whole), 97), len(whole) - 1]:
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        reader = BagReader(tmp_path / "cut.mcap")
        found = list(reader)
        assert reader.truncated
        assert found == everything[: len(found)]
        assert len(found) >= last
        if sum(end <= size for end in ends) == len(ends):
            assert found == everything
        last = len(found)
    assert last == len(everything)


def test_file_that_ends_in_unwritten_zeros_is_cut_off(tmp_path):
    """After a power loss a file may have its full length and zeros at its end."""
    (tmp_path / "run.mcap").write_bytes(START + HEADER + SCHEMA + CHANNEL + MESSAGE + bytes(5000))
    reader = BagReader(tmp_path / "run.mcap")
    assert len(list(reader)) == 1
    assert reader.truncated


def test_minimal_file_without_summary_is_whole(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(START + HEADER + chunk(SCHEMA + CHANNEL + MESSAGE) + DATA_END + FOOTER)
    reader = BagReader(path)
    assert [decode_string(m.data) for m in reader] == ["hello"]
    assert not reader.truncated


GOOD = SCHEMA + CHANNEL + MESSAGE


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "expected an mcap file"),
        (START[:5], "expected an mcap file"),
        (b"#ROSBAG V2.0\n" + bytes(100), "expected an mcap file"),
        (START + record(6, b""), "a chunk"),
        (START + struct.pack("<BQ", 6, 2**40) + bytes(50), "at most 268435456 bytes"),
        (START + struct.pack("<BQ", 5, 2**63) + bytes(50), "at most 268435456 bytes"),
        (START + chunk(GOOD, claimed=2**40), "a chunk of at most"),
        (START + chunk(GOOD, claimed=len(GOOD) + 1), "a chunk of"),
        (START + chunk(GOOD, crc=zlib.crc32(GOOD) ^ 1), "a chunk of CRC"),
        (START + chunk(GOOD[:-3]), "bytes longer"),
        (START + chunk(GOOD + b"\x05\x00"), "whole records"),
        (START + chunk(GOOD + struct.pack("<BQ", 5, 2**60)), "bytes longer"),
        (START + chunk(SCHEMA + MESSAGE), "a known channel"),
        (START + chunk(GOOD + record(5, b"abc")), "a message of at least 22 bytes"),
        (START + chunk(GOOD, compression=b"brotli"), "a chunk in zstd or lz4"),
        (START + chunk(GOOD, compression=b"zstd"), "a zstd chunk"),
        (START + chunk(GOOD, compression=b"lz4"), "a lz4 chunk"),
        (START + chunk(GOOD, compression=b"\xff"), "a chunk"),
        (START + record(4, b"\x01"), "a schema or channel"),
        (START + record(3, struct.pack("<HI", 1, 1) + b"\xff"), "a schema or channel"),
    ],
)
def test_corrupt_file_is_one_line(tmp_path, content, line):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError) as caught:
        list(read_messages(path))
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("sized", [True, False])
def test_decompression_bomb_is_refused_before_it_grows(tmp_path, compression, sized):
    """A few kilobytes that decompress to 64 MiB behind a chunk that claims 1,000 bytes."""
    import lz4.frame
    import zstandard

    zeros = bytes(64 * 2**20)
    if compression == "zstd":
        stored = zstandard.ZstdCompressor(write_content_size=sized).compress(zeros)
    else:
        stored = lz4.frame.compress(zeros, store_size=sized)
    del zeros
    path = tmp_path / "run.mcap"
    path.write_bytes(START + chunk(b"", claimed=1000, compression=compression.encode(), stored=stored))
    tracemalloc.start()
    try:
        with pytest.raises(BagError, match="chunk"):
            list(read_messages(path))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * 2**20


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_flipped_bytes_give_messages_or_one_line(tmp_path, compression):
    whole = write(tmp_path / "run.mcap", compression, messages=MESSAGES[:40]).read_bytes()
    rng = random.Random(7)
    refused = []
    for _ in range(300):
        raw = bytearray(whole)
        for _ in range(rng.choice((1, 1, 8))):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
        (tmp_path / "bad.mcap").write_bytes(raw)
        try:
            assert len(list(read_messages(tmp_path / "bad.mcap"))) <= 80
        except BagError as error:
            refused.append(str(error))
    assert len(refused) > 100
    assert not any("\n" in line for line in refused)


def test_reading_holds_one_chunk_at_a_time(tmp_path):
    with BagWriter(tmp_path / "run.mcap", compression="zstd") as bag:
        for i in range(600):
            bag.write_string("/s", i, f"{i:06d}" * 10_000)  # 36 MB in all
    tracemalloc.start()
    try:
        assert sum(len(m.data) for m in read_messages(tmp_path / "run.mcap")) > 36_000_000
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 3 * 2**20


def test_wanted_topic_of_another_type_or_encoding_is_refused(tmp_path):
    path = write(tmp_path / "run.mcap")
    with pytest.raises(BagError, match=f"expected {STRING} on /ground_truth .* \\(got {POINT_STAMPED}\\)"):
        list(read_messages(path, {"/ground_truth": STRING}))
    (tmp_path / "json.mcap").write_bytes(START + SCHEMA + CHANNEL.replace(b"cdr", b"xml") + MESSAGE)
    with pytest.raises(BagError, match="in cdr on /s"):
        list(read_messages(tmp_path / "json.mcap", ["/s"]))
    assert list(read_messages(tmp_path / "json.mcap", ["/t"])) == []


@pytest.mark.parametrize(
    ("metadata", "line"),
    [
        (None, "in which is no metadata.yaml, mcap or db3 file"),
        ("", "expected rosbag2_bagfile_information"),
        ("a: [", "expected rosbag2's metadata"),
        ("rosbag2_bagfile_information: 3", "expected rosbag2_bagfile_information"),
        ("rosbag2_bagfile_information: {storage_identifier: tape}", "expected storage mcap or sqlite3"),
        ("rosbag2_bagfile_information: {storage_identifier: mcap}", "a list of relative_file_paths"),
        ("rosbag2_bagfile_information: {storage_identifier: sqlite3}", "expected a rosbag2 recording"),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [../../etc/passwd]}",
            "expected passwd in",
        ),
        ("[" * 1500, "expected rosbag2's metadata"),
        ("#" * 5_000_000, "at most 4194304 bytes"),
    ],
)
def test_folder_with_bad_metadata_is_one_line(tmp_path, metadata, line):
    if metadata is not None:
        (tmp_path / "metadata.yaml").write_text(metadata)
    with pytest.raises(BagError) as caught:
        list(read_messages(tmp_path))
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bag_that_is_not_there_or_not_sqlite(tmp_path):
    with pytest.raises(BagError, match="does not exist"):
        read_messages(tmp_path / "no.mcap")
    (tmp_path / "a.db3").write_bytes(b"no database" * 100)
    with pytest.raises(BagError, match="expected a rosbag2 recording"):
        list(read_messages(tmp_path / "a.db3"))
