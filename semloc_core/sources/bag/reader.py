"""Reads bags as a stream: an mcap file, also one that was cut off, or a rosbag2 folder as `ros2 bag record` writes it.

Recordings in sqlite3 and folders whose messages are compressed one by one go through `rosbags`.
"""

from __future__ import annotations

import logging
import re
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml

from semloc_core.errors import BagError
from semloc_core.sources.bag.kinds import kind_of, unpacked
from semloc_core.sources.bag.mcap_stream import MAX_RECORD_BYTES, McapStream
from semloc_core.text import short_repr

_LOG = logging.getLogger(__name__)
_MAX_METADATA_BYTES = 4 * 2**20


@short_repr
class BagMessage(NamedTuple):
    """A message of a bag: ``stamp_ns`` is when it was received, ``publish_ns`` when it was sent, ``data`` CDR."""

    topic: str
    type: str
    stamp_ns: int
    publish_ns: int
    data: bytes


class BagReader:
    """A bag's messages in file order, which for rosbag2 is the order of writing.

    Args:
        path: an mcap or db3 file, also one compressed with zstd or lz4, or a rosbag2 folder; told by content.
        topics: the topics that are wanted (None: all); a mapping also says which type each must have.
        max_record_bytes: a chunk or message above this is refused.
        quiet: log nothing.

    Attributes:
        types: topic -> type of all topics met so far, wanted or not.
        definitions: topic -> definition of its type (ros2msg), as far as met and the bag has it.
        truncated: a file was cut off; its messages up to the last whole chunk were given.
        unordered: how many messages were received before the one that precedes them in the bag.

    Raises:
        BagError: nothing is there, or a folder's metadata.yaml is malformed.

    """

    def __init__(
        self,
        path: str | Path,
        topics: Mapping[str, str] | Iterable[str] | None = None,
        *,
        max_record_bytes: int = MAX_RECORD_BYTES,
        quiet: bool = False,
    ) -> None:
        self._quiet = quiet
        self.path = Path(path)
        self.types: dict[str, str] = {}
        self.definitions: dict[str, str] = {}
        self.truncated = False
        self.unordered = 0
        self._expected: Mapping[str, str] = topics if isinstance(topics, Mapping) else {}
        self._topics = None if topics is None else frozenset(topics)
        self._limit = max_record_bytes
        if not self.path.exists():
            raise BagError(f"expected a bag (got {self.path}, which does not exist)")
        self._files: list[Path] | None = [self.path]
        if self.path.is_dir():
            self._files = _files_of(self.path, quiet)

    def __iter__(self) -> Iterator[BagMessage]:
        """Messages of the wanted topics; the bag is read from its start each time.

        Raises:
            BagError: the bag is corrupt, or a wanted topic has another type or is not CDR.

        """
        self.truncated, self.unordered, latest = False, 0, 0
        for message in self._messages():
            self.unordered += message.stamp_ns < latest
            latest = max(latest, message.stamp_ns)
            yield message
        if self.unordered:
            _LOG.info("%s: %d messages are not in order of log time", self.path, self.unordered)

    def _messages(self) -> Iterator[BagMessage]:
        if self._files is None:
            yield from self._from_rosbags(self.path, self.path)
            return
        for file in self._files:
            with unpacked(file) as (whole, cut_off):
                if kind_of(whole) == "db3" or whole.suffix == ".db3":
                    if whole.suffix != ".db3":
                        raise BagError(f"expected a bag in sqlite3 to be named .db3 (got {file})")
                    yield from self._from_rosbags(whole, file)
                else:
                    yield from self._from_mcap(whole, file, cut_off)
                self.truncated |= cut_off

    def _cut_off(self, file: Path, given: int, lost: str) -> None:
        """Say what of a file could not be read, and that the rest is used."""
        if not self._quiet:
            used = f"the {given:,} messages before are used" if given else "no message comes before"
            _LOG.warning("%s is cut off: %s; %s", file, lost, used)
        self.truncated = True

    def _from_mcap(self, file: Path, named: Path, packed: bool) -> Iterator[BagMessage]:
        stream = McapStream(file, self._limit)
        wanted: dict[int, bool] = {}
        for channel, log_ns, publish_ns, data in stream:
            take = wanted.get(channel.id)
            if take is None:
                encoding = channel.message_encoding
                if (schema := stream.schemas.get(channel.schema_id)) is not None:
                    self.definitions[channel.topic] = schema.data.decode(errors="replace")
                take = wanted[channel.id] = self._wants(channel.topic, stream.type_of(channel), encoding)
            if take:
                type_ = self.types[channel.topic]
                yield BagMessage(channel.topic, type_, log_ns, publish_ns, bytes(data))
        if stream.truncated and not stream.lost_bytes:
            self._cut_off(named, stream.given, "only its index is lost")
        elif stream.truncated:
            size = "all" if packed else f"its last {stream.lost_bytes:,} bytes, all"
            self._cut_off(named, stream.given, f"{size} that follows its last whole chunk, can't be read")

    def _from_rosbags(self, path: Path, named: Path) -> Iterator[BagMessage]:
        from rosbags.rosbag2 import Reader

        given = 0
        try:
            with Reader(path) as reader:
                for c in reader.connections:
                    self.definitions[c.topic] = c.msgdef.data
                connections = [c for c in reader.connections if self._wants(c.topic, c.msgtype, "cdr")]
                # rosbags takes an empty list for "all".
                for connection, stamp_ns, data in reader.messages(connections) if connections else ():
                    yield BagMessage(connection.topic, connection.msgtype, stamp_ns, stamp_ns, bytes(data))
                    given += 1
        except BagError:
            raise
        except Exception as error:
            # rosbags' own errors, those of its database and decompressor, and whatever odd metadata leads to.
            if given and isinstance(error, sqlite3.DatabaseError):
                self._cut_off(named, given, "what follows can't be read")
                return
            raise BagError(f"expected a rosbag2 recording (got {self.path}: {_line(error)})") from error

    def _wants(self, topic: str, type_: str, encoding: str) -> bool:
        self.types[topic] = type_
        if self._topics is None:
            return True
        if topic not in self._topics:
            return False
        expected = self._expected.get(topic, type_)
        if type_ != expected:
            raise BagError(f"expected {expected} on {topic} in {self.path} (got {type_ or 'no type'})")
        if encoding != "cdr":
            raise BagError(f"expected messages in cdr on {topic} in {self.path} (got {encoding!r})")
        return True


def read_messages(path: str | Path, topics: Mapping[str, str] | Iterable[str] | None = None) -> Iterator[BagMessage]:
    """Messages of a bag in file order, in bounded memory; see `BagReader` for arguments and errors."""
    return iter(BagReader(path, topics))


def _files_of(folder: Path, quiet: bool) -> list[Path] | None:
    """The files of a rosbag2 folder in order; None where rosbags has to read it (sqlite3, compressed messages)."""
    file = folder / "metadata.yaml"
    if not file.is_file():
        # A recorder that was killed leaves none.
        found = sorted((p for p in folder.iterdir() if p.is_file() and kind_of(p)), key=_natural)
        if not found:
            raise BagError(f"expected a bag (got the folder {folder}, in which is no metadata.yaml, mcap or db3 file)")
        listed = ", ".join(path.name for path in found)
        if not quiet:
            _LOG.warning("%s has no metadata.yaml: its files are read in the order of their names: %s", folder, listed)
        return found
    information = _information(file)
    storage = information.get("storage_identifier")
    mode = str(information.get("compression_mode") or "none").lower()
    if storage == "sqlite3" or mode == "message":
        return None
    if storage != "mcap":
        raise BagError(f"expected storage mcap or sqlite3 in {file} (got {storage!r})")
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise BagError(f"expected a list of relative_file_paths in {file} (got {_line(repr(names))})")
    # Only names: old versions lead with the folder's, and nothing outside the folder is ever opened.
    files = [folder / PurePath(name).name for name in names]
    missing = [path.name for path in files if not path.is_file()]
    if missing:
        raise BagError(f"expected {missing[0]} in {folder} (got no such file)")
    return files


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sorts ``run_10`` behind ``run_9``."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _information(file: Path) -> dict[str, Any]:
    try:
        if (size := file.stat().st_size) > _MAX_METADATA_BYTES:
            raise BagError(f"expected metadata of at most {_MAX_METADATA_BYTES} bytes in {file} (got {size})")
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError, ValueError) as error:
        raise BagError(f"expected rosbag2's metadata in {file} (got {_line(error)})") from error
    information = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"expected rosbag2_bagfile_information in {file} (got {_line(repr(document))})")
    return information


def _line(value: object) -> str:
    """At most 120 characters on one line."""
    return " ".join(str(value).split())[:120]
