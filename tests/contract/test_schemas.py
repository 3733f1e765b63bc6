"""Code, schemas and examples agree: a message type can't change without its schema, nor a schema without examples."""

import json
from pathlib import Path

import msgspec
import pytest
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError

from semloc_core.errors import MessageError
from semloc_core.wire import decode, encode
from semloc_core.wire.codec import schema_of
from semloc_core.wire.messages import MESSAGES
from semloc_core.wire.schemas import main, message_schema, schema_text, write_schemas

FOLDER = Path(__file__).resolve().parents[2] / "msgs_schema"


def examples(kind: str):
    paths = [path for name in MESSAGES for path in sorted((FOLDER / name / kind).glob("*.json"))]
    return [pytest.param(p, id=f"{p.relative_to(FOLDER).parts[0]}-{p.stem}") for p in paths]


def schema_check(path: Path) -> None:
    """The schema's verdict alone, as any program in any language would have it."""
    name = path.relative_to(FOLDER).parts[0]
    schema = json.loads((FOLDER / f"{name}.schema.json").read_text())
    Draft202012Validator(schema).validate(json.loads(path.read_text()))


def decoder_check(path: Path) -> msgspec.Struct:
    return decode(path.read_bytes(), MESSAGES[path.relative_to(FOLDER).parts[0]])


@pytest.mark.parametrize("name", MESSAGES)
def test_the_file_is_what_the_types_generate(name):
    file = FOLDER / f"{name}.schema.json"
    assert file.read_text() == schema_text(MESSAGES[name]), "run: python -m semloc_core.wire.schemas msgs_schema"


def test_no_schema_without_a_message():
    assert sorted(p.name for p in FOLDER.glob("*.json")) == sorted(f"{n}.schema.json" for n in MESSAGES)


@pytest.mark.parametrize("name", MESSAGES)
def test_a_schema_is_strict_and_complete_in_itself(name):
    schema = message_schema(MESSAGES[name])
    Draft202012Validator.check_schema(schema)
    assert schema_of(MESSAGES[name]) == f"semloc/{name}/1"
    for part in [schema, *schema.get("$defs", {}).values()]:
        assert part["additionalProperties"] is False
        assert part["description"]
    references = {line.split('"')[3] for line in schema_text(MESSAGES[name]).splitlines() if '"$ref"' in line}
    assert {r.removeprefix("#/$defs/") for r in references} == set(schema.get("$defs", {}))


@pytest.mark.parametrize("name", MESSAGES)
def test_every_message_has_examples_of_every_kind(name):
    for kind, least in [("valid", 3), ("invalid/schema", 6), ("invalid/semantic", 2)]:
        assert len(list((FOLDER / name / kind).glob("*.json"))) >= least, (name, kind)


@pytest.mark.parametrize("path", examples("valid"))
def test_valid_examples_pass_both_and_survive_a_round_trip(path):
    schema_check(path)
    message = decoder_check(path)
    text = encode(message)
    assert decode(text, type(message)) == message
    Draft202012Validator(message_schema(type(message))).validate(json.loads(text))


@pytest.mark.parametrize("path", examples("invalid/schema"))
def test_what_the_schema_refuses_the_decoder_refuses(path):
    with pytest.raises((ValidationError, json.JSONDecodeError)):
        schema_check(path)
    with pytest.raises(MessageError) as caught:
        decoder_check(path)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith("expected ")


@pytest.mark.parametrize("path", examples("invalid/semantic"))
def test_what_only_the_decoder_can_refuse(path):
    schema_check(path)
    with pytest.raises(MessageError) as caught:
        decoder_check(path)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith("expected ")


def test_the_command_writes_the_schemas(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["schemas", str(tmp_path / "new")])
    main()
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == sorted(f"{n}.schema.json" for n in MESSAGES)
    assert [p.read_text() for p in write_schemas(tmp_path)] == [schema_text(t) for t in MESSAGES.values()]
