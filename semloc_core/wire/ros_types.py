"""The messages as ROS has them: ``python -m semloc_core.wire.ros_types semloc_msgs/msg`` writes the .msg files.

The types in `semloc_core.wire.messages` say everything; how they become ROS's is said here and nowhere else:

- ``stamp_ns`` and ``frame_id`` are the ``header``, ``schema`` and the values of a `Literal` are constants;
- a position is a geometry_msgs/Point, a struct a message of its own, a list an array;
- what may be null has a ``has_…`` before it, which ROS can't say otherwise;
- ``class`` is ``class_name``, since ``class`` is a word of C++.
"""

from __future__ import annotations

import argparse
import inspect
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect as types

from semloc_core.files import write_whole
from semloc_core.text import short_repr
from semloc_core.wire.codec import schema_of
from semloc_core.wire.messages import MESSAGES, ClassAttributions, PlaceMatches

PUBLISHED: tuple[type[msgspec.Struct], ...] = (PlaceMatches, ClassAttributions)
"""What is published typed; the types that these contain have messages too."""
POINT = "geometry_msgs/Point"
NAMES = {"class_": "class_name"}
SCALARS: dict[type[types.Type], str] = {
    types.FloatType: "float64",
    types.IntType: "int64",
    types.StrType: "string",
    types.BoolType: "bool",
    types.LiteralType: "string",
}
LINE = 100


@short_repr
class RosField(NamedTuple):
    """A field of a message.

    Attributes:
        attribute: of the struct.
        name: in the ROS message.
        ros_type: of one of its items: a scalar's, a message's of the package or geometry_msgs/Point.
        struct: the struct that such a message is of; None: it is of none of ours.
        length: None: it is no array; 0: of any length.
        nullable: whether a ``has_…`` stands before it.
        constants: the values that it may have, where these are listed.

    """

    attribute: str
    name: str
    ros_type: str
    struct: type[msgspec.Struct] | None = None
    length: int | None = None
    nullable: bool = False
    constants: tuple[str, ...] = ()

    @property
    def is_point(self) -> bool:
        """Whether its items are positions."""
        return self.ros_type == POINT


@cache
def ros_fields(struct: type[msgspec.Struct]) -> tuple[RosField, ...]:
    """The fields of a struct as a ROS message has them, but for the header's and the schema.

    Raises:
        TypeError: a field's type has no counterpart yet.

    """
    skipped = ("schema", "stamp_ns", "frame_id") if has_header(struct) else ()
    found: Any = types.type_info(struct)
    return tuple(
        _ros_field(field.name, field.encode_name, field.type) for field in found.fields if field.name not in skipped
    )


def has_header(struct: type[msgspec.Struct]) -> bool:
    """Whether it is a message for itself, with a header."""
    return struct in MESSAGES.values()


def structs() -> list[type[msgspec.Struct]]:
    """All structs that have a ROS message, those first that others contain."""
    found: dict[type[msgspec.Struct], None] = {}

    def take(struct: type[msgspec.Struct]) -> None:
        for field in ros_fields(struct):
            if field.struct is not None:
                take(field.struct)
        found[struct] = None

    for struct in PUBLISHED:
        take(struct)
    return list(found)


def message_text(struct: type[msgspec.Struct]) -> str:
    """The text of a struct's .msg file."""
    prose = inspect.cleandoc(struct.__doc__ or "").replace("``", "")
    lines = ["# Generated from semloc_core/wire/messages.py by semloc_core.wire.ros_types.", "#"]
    if any(field.nullable for field in ros_fields(struct)):
        lines.insert(1, "# Where has_x is false there is no x: it is null in JSON.")
    for paragraph in prose.split("\n\n"):
        lines += [f"# {line}" for line in textwrap.wrap(paragraph, LINE - 2)] + ["#"]
    lines[-1] = ""
    if has_header(struct):
        lines += [f'string SCHEMA="{schema_of(struct)}"', "", "std_msgs/Header header"]
    for field in ros_fields(struct):
        lines += _declared(field)
    return "\n".join(lines) + "\n"


def write_messages(folder: Path) -> list[Path]:
    """Write ``<Type>.msg`` for every message; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for struct in structs():
        path = folder / f"{struct.__name__}.msg"
        write_whole(path, message_text(struct).encode())
        paths.append(path)
    return paths


def _declared(field: RosField) -> Iterator[str]:
    if field.nullable:
        yield f"bool has_{field.name}"
    yield from (f'string {field.name.upper()}_{value.upper()}="{value}"' for value in field.constants)
    array = "" if field.length is None else f"[{field.length or ''}]"
    yield f"{field.ros_type}{array} {field.name}"


def _ros_field(attribute: str, encoded: str, type_: types.Type) -> RosField:
    name = NAMES.get(attribute, encoded)
    nullable = False
    if isinstance(type_, types.UnionType):
        (type_,) = (part for part in type_.types if not isinstance(part, types.NoneType))
        nullable = True
    length = None
    if isinstance(type_, types.ListType):
        length = type_.min_length if type_.min_length and type_.min_length == type_.max_length else 0
        type_ = type_.item_type
    made = RosField(attribute, name, "", None, length, nullable)
    if isinstance(type_, types.StructType):
        return made._replace(ros_type=type_.cls.__name__, struct=type_.cls)
    if isinstance(type_, types.TupleType) and [type(part) for part in type_.item_types] == [types.FloatType] * 3:
        return made._replace(ros_type=POINT)
    if isinstance(type_, types.LiteralType):
        made = made._replace(constants=tuple(str(value) for value in type_.values))
    scalar = SCALARS.get(type(type_))
    if scalar is None:
        raise TypeError(f"expected a type that ROS has a counterpart of (got {type_} for {attribute})")
    return made._replace(ros_type=scalar)


def main() -> None:
    """Command line: write the messages into a folder."""
    parser = argparse.ArgumentParser(description="Write the ROS messages of semloc.")
    parser.add_argument("folder", type=Path, help="where to write <Type>.msg")
    write_messages(parser.parse_args().folder)


if __name__ == "__main__":
    main()
