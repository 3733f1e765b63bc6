"""The model file: a .npz without pickle, one JSON header beside one .npy a tensor. Reading it executes nothing.

Members are stored, not compressed, so that no file unpacks to more than its own size; every tensor's shape and
type is known from the header's encoder before its bytes are looked at. `numpy.load` opens the file as well.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import struct
import zipfile
from collections.abc import Mapping
from tokenize import TokenError
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from semloc_core.errors import LabelspaceError, ModelError
from semloc_core.graph import Labelspace

VERSION = 1
MAX_BYTES = 256 * 2**20
MAX_MEMBERS = 4096
HEADER = "header.json"
EPOCH = (1980, 1, 1, 0, 0, 0)  # the same bytes whenever they are written
# what zipfile raises on a mangled archive, besides its own error
ZIP_ERRORS = (zipfile.BadZipFile, EOFError, ValueError, OSError, RuntimeError, struct.error, OverflowError)
# what numpy raises on a mangled header, which it takes for Python
NPY_ERRORS = (ValueError, SyntaxError, TokenError, TypeError, LookupError, RecursionError, MemoryError, EOFError)

Array = NDArray[Any]


class Header(msgspec.Struct, frozen=True):
    """Everything of a model but its tensors."""

    format: Literal["semloc/model"]
    version: int
    encoder: Annotated[str, Meta(pattern="^[a-z0-9_]{1,64}$")]
    config: dict[str, Any]
    labelspace: Labelspace
    seed: int
    temperature: float
    provenance: dict[str, Any]
    hash: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class _Version(msgspec.Struct):
    format: Literal["semloc/model"]
    version: int


def content_hash(encoder: str, config: Any, classes: tuple[str, ...], tensors: Mapping[str, Array]) -> str:
    """sha256 (hex) of what decides an answer: encoder, configuration, class names, tensors in order of name."""
    digest = hashlib.sha256(canonical_json({"encoder": encoder, "config": config, "classes": list(classes)}))
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(canonical_json([name, tensor.dtype.str, list(tensor.shape)]))
        digest.update(np.ascontiguousarray(tensor).tobytes())
    return digest.hexdigest()


def canonical_json(value: Any) -> bytes:
    """JSON with sorted keys and no spaces; NaN and what is no JSON raise ValueError or TypeError."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def pack(header: Header, tensors: Mapping[str, Array]) -> bytes:
    """Write a model file; the same content gives the same bytes.

    Raises:
        ModelError: the provenance is not JSON.

    """
    try:
        text = canonical_json(msgspec.to_builtins(header))
    except (TypeError, ValueError) as error:
        raise ModelError(f"expected a header that is plain JSON (got {error})") from error
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        _add(archive, HEADER, text)
        for name in sorted(tensors):
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(tensors[name], order="C"), (1, 0), allow_pickle=False)
            _add(archive, f"{name}.npy", member.getvalue())
    return buffer.getvalue()


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    info = zipfile.ZipInfo(name, EPOCH)
    info.create_system = 3  # whatever system writes
    info.external_attr = 0o644 << 16
    archive.writestr(info, content)


def unpack(data: bytes, max_bytes: int = MAX_BYTES) -> tuple[Header, dict[str, bytes]]:
    """Read a model file's header, and the .npy bytes of its tensors by name.

    Args:
        data: the file's content.
        max_bytes: refuse more than this.

    Raises:
        ModelError: not a model, cut off, changed, compressed, too big, or of a later version.

    """
    if len(data) > max_bytes:
        raise ModelError(f"expected a model of at most {max_bytes} bytes (got {len(data)})")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = _members(archive, len(data))
    except ZIP_ERRORS as error:
        found = "a truncated or damaged one" if data.startswith(b"PK\x03\x04") else "something else"
        raise ModelError(f"expected a semloc model (got {found}: {one_line(error)})") from error
    if HEADER not in members:
        raise ModelError(f"expected a semloc model (got an archive without {HEADER})")
    header = _header(members.pop(HEADER))
    strangers = [name for name in members if not name.endswith(".npy")]
    if strangers:
        raise ModelError(f"expected only tensors beside the header (got {one_line(strangers[0])})")
    return header, {name.removesuffix(".npy"): content for name, content in members.items()}


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, bytes]:
    """Contents by name; sizes are checked as declared, before anything is read."""
    infos = archive.infolist()
    names = {info.filename for info in infos}
    if len(infos) > MAX_MEMBERS or len(names) != len(infos):
        raise ModelError(f"expected at most {MAX_MEMBERS} members, each once (got {len(infos)})")
    for info in infos:
        if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
            raise ModelError(f"expected stored members (got {one_line(info.filename)} compressed)")
    declared = sum(info.file_size for info in infos)
    if declared > size:
        raise ModelError(f"expected members of at most {size} bytes together (got {declared} declared)")
    return {info.filename: archive.read(info) for info in infos}


def _header(text: bytes) -> Header:
    try:
        version = msgspec.json.decode(text, type=_Version).version
        if version > VERSION:
            raise ModelError(f"expected a model of version {VERSION} or earlier (got {version})")
        return msgspec.json.decode(text, type=Header)
    except (msgspec.ValidationError, msgspec.DecodeError, RecursionError, UnicodeDecodeError, LabelspaceError) as error:
        raise ModelError(f"expected the header of a semloc model (got {one_line(error)})") from error


def read_tensor(name: str, content: bytes, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """Decode one .npy of a known shape and type; anything else is refused before memory is set aside for it.

    Raises:
        ModelError: another shape or type, too few or too many bytes, or a number that is not finite.

    """
    stream = io.BytesIO(content)
    try:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ModelError(f"expected tensor {name!r} as .npy 1.0 (got another version)")
        found_shape, fortran, found_dtype = np.lib.format.read_array_header_1_0(stream)
    except NPY_ERRORS as error:
        raise ModelError(f"expected tensor {name!r} as .npy (got {one_line(error)})") from error
    if found_shape != shape or found_dtype != dtype or fortran:
        raise ModelError(
            f"expected tensor {name!r} of shape {shape} and type {dtype} (got {found_shape} and {found_dtype})"
        )
    payload, size = content[stream.tell() :], math.prod(shape) * dtype.itemsize
    if len(payload) != size:
        raise ModelError(f"expected {size} bytes in tensor {name!r} (got {len(payload)})")
    array: Array = np.frombuffer(payload, dtype).reshape(shape).copy()
    if not np.isfinite(array).all():
        raise ModelError(f"expected finite numbers in tensor {name!r} (got NaN or infinity)")
    return array


def one_line(value: object) -> str:
    """What a hostile file holds, cut to what fits into one line of an error."""
    text = " ".join(str(value).split()) or type(value).__name__
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[:201])
    return text if len(text) <= 200 else f"{text[:200]}…"
