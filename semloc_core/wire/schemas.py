"""JSON Schemas (2020-12) of the messages, made from their types: ``python -m semloc_core.wire.schemas msgs_schema``."""

from __future__ import annotations

import argparse
import inspect
import json
from pathlib import Path
from typing import Any

import msgspec

from semloc_core.files import write_whole
from semloc_core.wire.codec import schema_of
from semloc_core.wire.messages import MESSAGES

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def message_schema(type_: type[msgspec.Struct]) -> dict[str, Any]:
    """The JSON Schema of one message type, complete in itself.

    Args:
        type_: one of `semloc_core.wire.messages.MESSAGES`.

    """
    (_,), components = msgspec.json.schema_components([type_], ref_template="#/$defs/{name}")
    root = components.pop(type_.__name__)
    name, version = schema_of(type_).split("/")[1:]
    schema: dict[str, Any] = {"$schema": DIALECT, "$id": f"urn:semloc:{name}:{version}"} | root
    if components:
        schema["$defs"] = components
    for part in (schema, *components.values()):
        # docstrings keep their indentation before Python 3.13 and lose it from then on
        part["description"] = inspect.cleandoc(part["description"])
    return schema


def schema_text(type_: type[msgspec.Struct]) -> str:
    """The schema as the text of its file."""
    return json.dumps(message_schema(type_), indent=2, ensure_ascii=False) + "\n"


def write_schemas(folder: Path) -> list[Path]:
    """Write ``<message>.schema.json`` for every message; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, type_ in MESSAGES.items():
        path = folder / f"{name}.schema.json"
        write_whole(path, schema_text(type_).encode())
        paths.append(path)
    return paths


def main() -> None:
    """Command line: write the schemas into a folder."""
    parser = argparse.ArgumentParser(description="Write the JSON Schemas of semloc's messages.")
    parser.add_argument("folder", type=Path, help="where to write <message>.schema.json")
    write_schemas(parser.parse_args().folder)


if __name__ == "__main__":
    main()
