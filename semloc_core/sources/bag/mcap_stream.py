"""Messages of one mcap file, front to back, in memory bounded by its largest chunk.

Why not the library's own stream reader: it trusts the lengths and sizes that a record claims, takes a file that
was cut off for an exception, and checks nothing inside a chunk without CRC (rosbag2's default). The library's
record types are used once a record is known to be whole. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from semloc_core.errors import BagError
from semloc_core.files import BAG, other_kind
from semloc_core.text import short_repr

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 256 * 2**20
"""A chunk (as stored or decompressed) or message above this is refused."""

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_NEEDED = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END}
_SKIP_BYTES = 2**20
_TAIL = 16
"""Zeros that a record may well end with: a string's end and its padding."""


@short_repr
class RawMessage(NamedTuple):
    """A message as stored: its channel, log time and publish time (ns), and a view of its payload."""

    channel: Channel
    log_ns: int
    publish_ns: int
    data: memoryview


class _CutOffError(Exception):
    """The file ends before what its last record says; never leaves this module."""


class McapStream:
    """The messages of an mcap file, in file order.

    Attributes:
        channels: channel id -> channel, as far as read.
        schemas: schema id -> schema, as far as read.
        truncated: the file was cut off; all messages of whole chunks were given. Known once iteration ends.
        given: how many messages were.
        lost_bytes: of a file that was cut off, what follows its last whole chunk; 0 where no message can be in it.

    """

    def __init__(self, path: Path, max_record_bytes: int = MAX_RECORD_BYTES) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.truncated = False
        self.given = self.lost_bytes = 0
        self._limit = max_record_bytes

    def type_of(self, channel: Channel) -> str:
        """Name of a channel's message type; empty where it has none."""
        schema = self.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def __iter__(self) -> Iterator[RawMessage]:
        """Messages in file order.

        Raises:
            BagError: not an mcap file, or one that is corrupt: CRC, lengths, sizes, a message without channel.

        """
        try:
            with self.path.open("rb") as stream:
                for message in self._messages(stream, os.fstat(stream.fileno()).st_size):
                    self.given += 1
                    yield message
        except _CutOffError:
            self.truncated = True
        except OSError as error:
            raise BagError(f"expected a bag that can be read (got {error})") from error

    def _messages(self, stream: IO[bytes], size: int) -> Iterator[RawMessage]:
        start = stream.read(len(MAGIC))
        if start != MAGIC:
            found = other_kind(self.path, BAG) or f"{size} bytes that begin {start!r}"
            raise BagError(f"expected an mcap file (got {self.path}, {found})")
        crc, zeros = zlib.crc32(start), _zeros_from(stream, size)
        while True:
            self.lost_bytes = size - stream.tell()
            head = stream.read(_RECORD.size)
            if len(head) < _RECORD.size:
                raise _CutOffError
            opcode, length = _RECORD.unpack(head)
            if opcode == 0:
                # Not an mcap opcode: a part of the file that was allotted and never written (power loss).
                raise _CutOffError
            needed = opcode in _NEEDED
            if needed and length > self._limit:
                raise self._corrupt(f"a record of at most {self._limit} bytes", f"{length} bytes")
            if length > size - stream.tell():
                raise _CutOffError
            if opcode == Opcode.DATA_END:
                self.lost_bytes = 0
                self._check_end(stream, length, crc)
                return
            crc = zlib.crc32(head, crc)
            if not needed:
                crc = _skip(stream, length, crc)
                continue
            body = stream.read(length)
            if len(body) < length:
                raise _CutOffError
            if _is_zero(body[-_TAIL:]) and zeros <= stream.tell() < size:
                # The file was allotted further than it was written when the power went, from within this record on.
                raise _CutOffError
            crc = zlib.crc32(body, crc)
            try:
                yield from self._take(opcode, memoryview(body))
            except BagError as error:
                if zeros <= stream.tell() < size:
                    raise _CutOffError from error
                raise

    def _check_end(self, stream: IO[bytes], length: int, crc: int) -> None:
        """Compare the data section's CRC (0: none was made) and see that the file is whole behind it."""
        body = stream.read(length)
        if len(body) >= 4:
            (expected,) = struct.unpack_from("<I", body)
            if expected not in (0, crc):
                raise self._corrupt(f"data of CRC {expected:#010x}", f"{crc:#010x}")
        stream.seek(-len(MAGIC), os.SEEK_END)
        if stream.read() != MAGIC:
            raise _CutOffError

    def _take(self, opcode: int, body: memoryview) -> Iterator[RawMessage]:
        if opcode == Opcode.MESSAGE:
            yield self._message(body)
        elif opcode == Opcode.CHUNK:
            yield from self._chunk(body)
        else:
            self._define(opcode, body)

    def _chunk(self, body: memoryview) -> Iterator[RawMessage]:
        try:
            chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
        except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
            raise self._corrupt("a chunk", f"one whose head is broken: {error or type(error).__name__}") from error
        if chunk.uncompressed_size > self._limit:
            raise self._corrupt(f"a chunk of at most {self._limit} bytes", f"{chunk.uncompressed_size} bytes")
        data = self._decompress(chunk)
        if len(data) != chunk.uncompressed_size:
            raise self._corrupt(f"a chunk of {chunk.uncompressed_size} bytes", f"{len(data)} bytes")
        if chunk.uncompressed_crc not in (0, found := zlib.crc32(data)):
            raise self._corrupt(f"a chunk of CRC {chunk.uncompressed_crc:#010x}", f"{found:#010x}")
        view, offset = memoryview(data), 0
        while offset < len(view):
            if offset + _RECORD.size > len(view):
                raise self._corrupt("a chunk of whole records", f"{len(view) - offset} bytes at its end")
            opcode, length = _RECORD.unpack_from(view, offset)
            start = offset + _RECORD.size
            offset = start + length
            if offset > len(view):
                raise self._corrupt("a record inside its chunk", f"one that is {offset - len(view)} bytes longer")
            if opcode == Opcode.MESSAGE:
                yield self._message(view[start:offset])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, view[start:offset])

    def _decompress(self, chunk: Chunk) -> bytes:
        """Never more than the size that the chunk claims, which has been checked, plus one byte."""
        claimed = chunk.uncompressed_size
        if chunk.compression == "":
            return chunk.data
        try:
            if chunk.compression == "zstd":
                import zstandard

                # The frame's own claim goes before max_output_size in the library, so look at it first.
                if zstandard.frame_content_size(chunk.data) > claimed:
                    raise self._corrupt(f"a chunk of {claimed} bytes", "a zstd frame that claims more")
                # An unknown size and an empty chunk: 0 would mean "no limit".
                return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=max(claimed, 1))
            if chunk.compression == "lz4":
                from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # ships no types

                data: bytes = LZ4FrameDecompressor().decompress(chunk.data, max_length=claimed + 1)
                return data
        except ImportError as error:
            raise BagError(f"expected the package that reads {chunk.compression} chunks (got {error})") from error
        except BagError:
            raise
        except Exception as error:
            # zstandard and lz4 raise errors of their own, RuntimeError, EOFError or MemoryError.
            raise self._corrupt(f"a {chunk.compression} chunk", f"one that does not decompress: {error}") from error
        raise self._corrupt("a chunk in zstd or lz4", repr(chunk.compression))

    def _define(self, opcode: int, body: memoryview) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
            else:
                channel = Channel.read(stream)
                self.channels[channel.id] = channel
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise self._corrupt("a schema or channel", f"a broken one: {error or type(error).__name__}") from error

    def _message(self, body: memoryview) -> RawMessage:
        if len(body) < _MESSAGE.size:
            raise self._corrupt(f"a message of at least {_MESSAGE.size} bytes", f"{len(body)} bytes")
        channel_id, _, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        channel = self.channels.get(channel_id)
        if channel is None:
            raise self._corrupt("a message of a known channel", f"channel {channel_id}")
        return RawMessage(channel, log_ns, publish_ns, body[_MESSAGE.size :])

    def _corrupt(self, expected: str, got: str) -> BagError:
        return BagError(f"expected {expected} in {self.path} (got {got})")


def _is_zero(data: bytes) -> bool:
    return data.count(0) == len(data)


def _zeros_from(stream: IO[bytes], size: int) -> int:
    """Where the zeros begin that a file ends with; its size where it ends with none. The position is kept."""
    start, end = stream.tell(), size
    try:
        while end > 0:
            stream.seek(max(0, end - _SKIP_BYTES))
            piece = stream.read(end - stream.tell())
            left = len(piece.rstrip(b"\0"))
            end -= len(piece) - left
            if left:
                break
        return end
    finally:
        stream.seek(start)


def _skip(stream: IO[bytes], length: int, crc: int) -> int:
    """Pass over a record in pieces, whatever its size, and carry the CRC along."""
    while length > 0:
        piece = stream.read(min(length, _SKIP_BYTES))
        if not piece:
            raise _CutOffError
        length -= len(piece)
        crc = zlib.crc32(piece, crc)
    return crc
