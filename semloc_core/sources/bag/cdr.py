"""CDR, ROS 2's wire encoding, of the types that our bags hold: String, PointStamped and PoseStamped.

A payload is a four-byte header (0, byte order, two option bytes) and the fields, each aligned to its size
counted from behind the header. Decoding trusts no length: what does not fit is a `BagError`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from semloc_core.errors import BagError
from semloc_core.text import short_repr
from semloc_core.wire import Position

STRING = "std_msgs/msg/String"
POINT_STAMPED = "geometry_msgs/msg/PointStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"

Quaternion = tuple[float, float, float, float]

_HEADER = 4
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_NS_PER_S = 1_000_000_000
# Some middlewares pad a payload to a multiple of four bytes.
_MAX_PADDING = 3


class StampedPoint(NamedTuple):
    """A position (m) in ``frame_id`` at ``stamp_ns``."""

    stamp_ns: int
    frame_id: str
    position: Position


@short_repr
class StampedPose(NamedTuple):
    """A position (m) and orientation (unit quaternion) in ``frame_id`` at ``stamp_ns``."""

    stamp_ns: int
    frame_id: str
    position: Position
    orientation_xyzw: Quaternion


Truth = StampedPoint | StampedPose


def encode_string(text: bytes | str) -> bytes:
    """CDR (little endian) of a std_msgs/String; bytes are taken as UTF-8.

    Raises:
        BagError: the text is longer than CDR can say.

    """
    raw = text.encode() if isinstance(text, str) else text
    if len(raw) >= 2**32 - 1:
        raise BagError(f"expected a string below 4 GiB (got {len(raw)} bytes)")
    return b"".join((_LITTLE_ENDIAN, struct.pack("<I", len(raw) + 1), raw, b"\x00"))


def decode_string(cdr: bytes | memoryview) -> str:
    """Text of a std_msgs/String in either byte order; the characters are copied once.

    Raises:
        BagError: not a CDR string, cut off, longer than its length says, or not UTF-8.

    """
    view, order = _open(cdr)
    text, end = _string(view, _HEADER, order)
    _close(view, end)
    return text


def encode_point(stamp_ns: int, frame_id: str, position: Position) -> bytes:
    """CDR (little endian) of a geometry_msgs/PointStamped; the stamp's seconds must fit 32 bits signed.

    Raises:
        BagError: the stamp is out of the range of builtin_interfaces/Time.

    """
    return _stamped(stamp_ns, frame_id) + struct.pack("<3d", *position)


def encode_pose(stamp_ns: int, frame_id: str, position: Position, orientation_xyzw: Quaternion) -> bytes:
    """CDR (little endian) of a geometry_msgs/PoseStamped; see `encode_point`."""
    return _stamped(stamp_ns, frame_id) + struct.pack("<7d", *position, *orientation_xyzw)


def encode_pose_with_covariance(
    stamp_ns: int, frame_id: str, position: Position, orientation_xyzw: Quaternion, covariance: Sequence[float]
) -> bytes:
    """CDR (little endian) of a geometry_msgs/PoseWithCovarianceStamped (36 numbers); see `encode_point`."""
    return _stamped(stamp_ns, frame_id) + struct.pack("<43d", *position, *orientation_xyzw, *covariance)


def _stamped(stamp_ns: int, frame_id: str) -> bytes:
    """A payload up to where its first double begins."""
    seconds, nanoseconds = divmod(stamp_ns, _NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        raise BagError(f"expected a stamp of 32-bit seconds (got {stamp_ns} ns)")
    frame = frame_id.encode() + b"\x00"
    fields = struct.pack("<iII", seconds, nanoseconds, len(frame)) + frame
    return _LITTLE_ENDIAN + fields + b"\x00" * (-len(fields) % 8)


def decode_point(cdr: bytes | memoryview) -> StampedPoint:
    """A geometry_msgs/PointStamped in either byte order.

    Raises:
        BagError: not CDR, cut off, longer than its fields, or a frame that is not UTF-8.

    """
    stamp_ns, frame_id, (x, y, z) = _doubles(cdr, 3)
    return StampedPoint(stamp_ns, frame_id, (x, y, z))


def decode_pose(cdr: bytes | memoryview) -> StampedPose:
    """A geometry_msgs/PoseStamped in either byte order; see `decode_point`."""
    stamp_ns, frame_id, (x, y, z, *turn) = _doubles(cdr, 7)
    return StampedPose(stamp_ns, frame_id, (x, y, z), (turn[0], turn[1], turn[2], turn[3]))


def _doubles(cdr: bytes | memoryview, count: int) -> tuple[int, str, tuple[float, ...]]:
    """Stamp (ns), frame and the doubles behind the header."""
    view, order = _open(cdr)
    seconds, nanoseconds = _unpack(view, _HEADER, order + "iI")
    frame_id, end = _string(view, _HEADER + 8, order)
    start = end + -(end - _HEADER) % 8
    values = _unpack(view, start, f"{order}{count}d")
    _close(view, start + 8 * count)
    return seconds * _NS_PER_S + nanoseconds, frame_id, values


def _open(cdr: bytes | memoryview) -> tuple[memoryview, str]:
    view = memoryview(cdr)
    if len(view) < _HEADER or view[0] != 0 or view[1] > 1:
        raise BagError(f"expected a CDR payload (got {len(view)} bytes, header {bytes(view[:4]).hex()!r})")
    return view, "<" if view[1] else ">"


def _unpack(view: memoryview, offset: int, form: str) -> tuple[Any, ...]:
    if offset + struct.calcsize(form) > len(view):
        raise BagError(f"expected a whole CDR payload (got one cut off at {len(view)} bytes)")
    return struct.unpack_from(form, view, offset)


def _string(view: memoryview, offset: int, order: str) -> tuple[str, int]:
    """Text at ``offset`` and the offset behind it; a length of 0 is what some middlewares write for no text."""
    (length,) = _unpack(view, offset, order + "I")
    start, end = offset + 4, offset + 4 + length
    if end > len(view):
        raise BagError(f"expected a CDR string of {length} bytes (got {len(view) - start})")
    if length == 0:
        return "", end
    if view[end - 1] != 0:
        raise BagError(f"expected a CDR string that ends in NUL (got {view[end - 1]:#04x})")
    try:
        return str(view[start : end - 1], "utf-8"), end
    except UnicodeDecodeError as error:
        raise BagError(f"expected UTF-8 in a CDR string (got {error.reason} at byte {error.start})") from error


def _close(view: memoryview, end: int) -> None:
    if len(view) - end > _MAX_PADDING:
        raise BagError(f"expected a CDR payload of {end} bytes (got {len(view)})")
