"""The wire: JSON text to typed messages and back. The only file that knows what a message looks like as text.

The types are in `semloc_core.wire.messages`, their JSON Schemas in ``msgs_schema/`` (see
`semloc_core.wire.schemas`). Decoding is strict: unknown fields, wrong types, non-finite numbers, duplicate ids and
self-loops are refused with one line, and so is an edge of a full update that names an unknown node (for a delta
only the graph can tell: `semloc_core.graph.scene_graph`).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, TypeVar

import msgspec
import numpy as np

from semloc_core.errors import MessageError
from semloc_core.wire.checks import CHECKS, DECIMALS
from semloc_core.wire.messages import SceneGraphUpdate

MAX_BYTES = 16 * 2**20  # the default of `max_update_bytes`
LONGEST_LINE = 300

T = TypeVar("T", bound=msgspec.Struct)


class _Header(msgspec.Struct):
    schema: msgspec.Raw = msgspec.Raw(b"")


_header_decoder = msgspec.json.Decoder(_Header)


@cache
def _decoder(type_: type[T]) -> msgspec.json.Decoder[T]:
    return msgspec.json.Decoder(type_)


@cache
def schema_of(type_: type[msgspec.Struct]) -> str:
    """The ``schema`` of a message type, e.g. ``semloc/scene_graph_update/1``."""
    literal: Any = msgspec.structs.fields(type_)[0].type
    return str(literal.__args__[0])


def decode_update(data: bytes | str, max_bytes: int = MAX_BYTES) -> SceneGraphUpdate:
    """Decode a scene-graph update.

    Args:
        data: JSON text (UTF-8 if bytes).
        max_bytes: an update that is longer is refused before anything looks at it.

    Raises:
        MessageError: see `decode`.

    """
    return decode(data, SceneGraphUpdate, max_bytes)


def decode(data: bytes | str, type_: type[T], max_bytes: int = MAX_BYTES) -> T:
    """Decode a message, strictly.

    Args:
        data: JSON text (UTF-8 if bytes).
        type_: a message type, one of `MESSAGES`.
        max_bytes: a longer text is refused before anything looks at it.

    Raises:
        MessageError: the text is too long, not UTF-8, not JSON, nested too deeply, of another schema, or what it
            says can't be; one line.

    """
    expected = schema_of(type_)
    try:
        # a character is at least one byte, so a text that is too long is never copied
        if len(data) <= max_bytes and isinstance(data, str):
            data = data.encode()
        if len(data) > max_bytes:
            raise MessageError(f"expected a message of at most {max_bytes} bytes (got {len(data)})")
        message: T = _decoder(type_).decode(data)
    except UnicodeError as error:
        raise MessageError(one_line(f"expected UTF-8 text (got {error})")) from error
    except RecursionError as error:
        raise MessageError(f"expected a {expected} message (got JSON nested too deeply)") from error
    except msgspec.ValidationError as error:
        got = _schema_in(data)
        if got is not None and got != expected:
            raise MessageError(one_line(f"expected schema {expected} (got {got})")) from error
        raise MessageError(one_line(f"expected a valid {expected} message (got: {error})")) from error
    except msgspec.DecodeError as error:
        raise MessageError(one_line(f"expected JSON text (got: {error})")) from error
    if (check := CHECKS.get(type_)) is not None:
        try:
            check(message)
        except MessageError as error:
            raise MessageError(one_line(str(error))) from None
    return message


def _schema_in(data: bytes | str) -> str | None:
    """What a refused text says its schema is; None where even that can't be read."""
    try:
        raw = bytes(_header_decoder.decode(data).schema)
        return str(msgspec.json.decode(raw, type=str)) if raw else "none"
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None


def encode(message: msgspec.Struct) -> bytes:
    """A message as compact JSON, in the order of its fields; the same message gives the same bytes.

    Floats are rounded to 6 decimals and -0.0 is written as 0.0, so that a replay is byte-identical wherever the
    last bits differ. NumPy scalars are taken for what they hold.

    Raises:
        MessageError: a float is NaN or infinite, or a value has no JSON form.

    """
    try:
        return msgspec.json.encode(_rounded(msgspec.to_builtins(message, enc_hook=_scalar)))
    except (TypeError, UnicodeError, OverflowError, RecursionError) as error:
        raise MessageError(one_line(f"expected values that JSON can hold (got: {error})")) from error


def _scalar(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__}")


def _rounded(value: Any) -> Any:
    type_ = type(value)  # `msgspec.to_builtins` makes no subclasses
    if type_ is float:
        if not math.isfinite(value):
            raise MessageError(f"expected finite numbers in a message (got {value})")
        return round(value, DECIMALS) + 0.0  # -0.0 + 0.0 is 0.0
    if type_ is dict:
        found: dict[str, Any] = {key: item if type(item) is str else _rounded(item) for key, item in value.items()}
        if "labels" in found and not isinstance(labels := found["labels"], float):  # float: of a class of this name
            # Null is left out, so that objects without labels are written as before there were any; in order of names,
            # without those that are rounded to nothing.
            found["labels"] = {name: p for name, p in sorted((labels or {}).items()) if p}
            if not found["labels"]:
                del found["labels"]
        return found
    if type_ is list or type_ is tuple:
        return [_rounded(item) for item in value]
    return value


def one_line(text: str) -> str:
    """Text as a single line of at most 300 characters: what another machine sent is never printed raw."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text)
    return line if len(line) <= LONGEST_LINE else line[: LONGEST_LINE - 1] + "…"
