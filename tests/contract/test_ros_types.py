"""The .msg files of semloc_msgs are what the messages' types make, and hold all that these hold."""

from pathlib import Path

import msgspec
import pytest

from semloc_core.wire.messages import Explanation, Match, PlaceMatches
from semloc_core.wire.ros_types import main, message_text, ros_fields, structs, write_messages

FOLDER = Path(__file__).resolve().parents[2] / "semloc_msgs" / "msg"


def declared(struct):
    return [line for line in message_text(struct).splitlines() if line and not line.startswith("#")]


@pytest.mark.parametrize("struct", structs(), ids=lambda s: s.__name__)
def test_the_file_is_what_the_types_generate(struct):
    text = (FOLDER / f"{struct.__name__}.msg").read_text(encoding="utf-8")
    assert text == message_text(struct), "run: python -m semloc_core.wire.ros_types semloc_msgs/msg"


def test_no_file_without_a_type():
    assert sorted(path.name for path in FOLDER.iterdir()) == sorted(f"{s.__name__}.msg" for s in structs())


def test_a_message_within_a_message():
    assert declared(Match) == [
        "int64 rank",
        "string map",
        "string place",
        "geometry_msgs/Point position",
        "float64 similarity",
        "float64 probability",
        "bool has_pose",
        "Pose pose",
    ]


def test_a_message_for_itself_has_a_header_and_constants():
    lines = declared(PlaceMatches)
    assert lines[:5] == [
        'string SCHEMA="semloc/place_matches/1"',
        "std_msgs/Header header",
        "int64 seq",
        "bool has_query_place",
        "string query_place",
    ]
    assert 'string STATUS_NO_GRAPH="no_graph"' in lines
    at = lines.index("Match[] raw_matches")
    assert lines[at - 1] == "bool has_raw_matches"


@pytest.mark.parametrize("struct", structs(), ids=lambda s: s.__name__)
def test_every_field_is_there(struct):
    header = {"schema", "stamp_ns", "frame_id"}
    fields = {field.name for field in msgspec.structs.fields(struct)}
    assert {field.attribute for field in ros_fields(struct)} == fields - header


def test_lists_of_a_known_length_and_words_of_cpp():
    lines = [line for struct in structs() for line in declared(struct)]
    assert "float64[16] covariance" in lines
    assert "string class_name" in lines
    assert not [line for line in lines if line.split()[-1] == "class"]


def test_a_type_that_ros_has_no_counterpart_of_is_said():
    class Odd(msgspec.Struct):
        what: dict[str, float]

    with pytest.raises(TypeError, match="for what"):
        ros_fields(Odd)
    assert ros_fields(Explanation)[-1].nullable


def test_the_command_writes_them(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["ros_types", str(tmp_path / "msg")])
    main()
    written = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "msg").iterdir()}
    assert written == {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    assert len(write_messages(tmp_path / "msg")) == len(written)
