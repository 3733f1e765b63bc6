"""Writes bags that `ros2 bag play` (Jazzy) accepts: a bare mcap file, or a rosbag2 folder with its metadata.yaml.

The layout is that of rosbag2_storage_mcap: profile ``ros2``, schemas as ``ros2msg``, messages as ``cdr``, and
each channel's ``offered_qos_profiles`` and ``topic_type_hash``. The same messages give the same bytes.
"""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from semloc_core.errors import BagError
from semloc_core.files import (
    beside,
    check_claim,
    is_stream,
    must_be_new,
    open_stream,
    publish,
    real,
    remove,
    replaces,
    written,
)
from semloc_core.sources.bag.cdr import (
    POINT_STAMPED,
    POSE_STAMPED,
    STRING,
    Quaternion,
    encode_point,
    encode_pose,
    encode_string,
)
from semloc_core.sources.bag.reader import BagMessage
from semloc_core.sources.bag.typed import typestore
from semloc_core.wire import Position

_LOG = logging.getLogger(__name__)

CHUNK_BYTES = 256 * 1024
"""A chunk goes to the file when it holds more than this: what a process that is killed can lose."""

Compression = Literal["none", "zstd", "lz4"]
_COMPRESSION = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
_METADATA_VERSION = 9
# rmw's RMW_DURATION_INFINITE, as rosbag2 writes it.
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
# A player offers what the recorder was offered: reliable and deep, because deltas must not be lost.
_QOS = {
    "history": "keep_last",
    "depth": 1000,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}


# Who listens for static transforms asks for those that were sent before.
_STATIC = _QOS | {"durability": "transient_local"}


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors: the same profile under two topics is written out twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _qos(topic: str) -> dict[str, Any]:
    return _STATIC if topic.endswith("/tf_static") else _QOS


def _to_yaml(value: Any) -> str:
    text: str = yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False)
    return text


class _Topic(NamedTuple):
    channel: int
    type: str
    type_hash: str


class BagWriter:
    """Writes messages in the order they come; use it as a context manager.

    Each chunk reaches the file as soon as it is full, so that a file that was never closed can be read up to its
    last chunk. `close` is called however the ``with`` block ends: what was written stays readable. A bag that takes
    the place of one which the running command may replace does so when it is whole; after an error the old one stays.

    Args:
        path: ``….mcap`` is a bare mcap file (overwritten); anything else a rosbag2 folder (new or empty).
        compression: of chunks.
        chunk_bytes: uncompressed size from which on a chunk is closed.

    Raises:
        BagError: the file or folder can't be made, or the folder holds something.

    """

    def __init__(self, path: str | Path, *, compression: Compression = "none", chunk_bytes: int = CHUNK_BYTES) -> None:
        if compression not in _COMPRESSION:
            raise BagError(f"expected compression none, zstd or lz4 (got {compression!r})")
        self.path = Path(path)
        self._folder = None if self.path.suffix == ".mcap" else self.path
        empty = self._folder is not None and self.path.is_dir() and not any(self.path.iterdir())
        self._aside = beside(real(self.path)) if replaces(self.path) and not empty else None
        if self._folder is not None:
            self._folder = self._aside or self.path
        self.file = (self._aside or self.path) if self._folder is None else self._folder / f"{self.path.name}_0.mcap"
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._start_ns, self._end_ns = 2**63 - 1, 0
        check_claim(self.path)
        try:
            if self._folder is not None and not is_stream(self.path):
                self._folder.mkdir(parents=True, exist_ok=True)
                if any(self._folder.iterdir()):
                    raise BagError(f"expected a new or empty folder for a bag (got {self._folder})")
            if is_stream(self.path):
                self._folder, self.file = None, self.path
                self._stream: IO[bytes] = open_stream(self.path)
            else:
                self._stream = self.file.open("xb" if must_be_new(self.path) else "wb")
            if self._aside is None:
                written(self.path)
        except OSError as error:
            raise BagError(f"expected a bag that can be written (got {error})") from error
        self._mcap: Writer | None = Writer(self._stream, chunk_size=chunk_bytes, compression=_COMPRESSION[compression])
        self._mcap.start(profile="ros2", library="semloc")

    def write(self, topic: str, type_: str, stamp_ns: int, data: bytes, *, publish_ns: int | None = None) -> None:
        """Append one message.

        Args:
            topic: e.g. ``/scene_graph``.
            type_: a type that ROS 2 Jazzy ships, or of vision_msgs, e.g. ``std_msgs/msg/String``.
            stamp_ns: when it was received (mcap's log time, what a player goes by), ns, not negative.
            data: the message as CDR.
            publish_ns: when it was sent; by default the same.

        Raises:
            BagError: closed, negative stamp, unknown type, a topic with two types, or the disk refuses.

        """
        if self._mcap is None:
            raise BagError(f"expected a bag that is open (got {self.path}, which is closed)")
        publish_ns = stamp_ns if publish_ns is None else publish_ns
        if not (0 <= stamp_ns < 2**63 and 0 <= publish_ns < 2**63):
            raise BagError(f"expected a stamp in 0 … 2^63 - 1 ns (got {min(stamp_ns, publish_ns)})")
        try:
            entry = self._topics.get(topic) or self._add_topic(self._mcap, topic, type_)
            if entry.type != type_:
                raise BagError(f"expected {entry.type} on {topic} as before (got {type_})")
            self._mcap.add_message(entry.channel, stamp_ns, data, publish_ns)
            self._stream.flush()
        except OSError as error:
            raise BagError(f"expected room for a bag at {self.path} (got {error})") from error
        self._counts[topic] += 1
        self._start_ns, self._end_ns = min(self._start_ns, stamp_ns), max(self._end_ns, stamp_ns)

    def write_string(self, topic: str, stamp_ns: int, text: bytes | str) -> None:
        """Append a std_msgs/String; see `write`."""
        self.write(topic, STRING, stamp_ns, encode_string(text))

    def write_point(self, topic: str, stamp_ns: int, frame_id: str, position: Position) -> None:
        """Append a geometry_msgs/PointStamped (m) whose header has the same stamp; see `write`."""
        self.write(topic, POINT_STAMPED, stamp_ns, encode_point(stamp_ns, frame_id, position))

    def write_pose(
        self, topic: str, stamp_ns: int, frame_id: str, position: Position, orientation_xyzw: Quaternion
    ) -> None:
        """Append a geometry_msgs/PoseStamped (m, unit quaternion) whose header has the same stamp; see `write`."""
        self.write(topic, POSE_STAMPED, stamp_ns, encode_pose(stamp_ns, frame_id, position, orientation_xyzw))

    def write_raw(self, message: BagMessage) -> None:
        """Append a message of another bag as it is; see `write`."""
        self.write(message.topic, message.type, message.stamp_ns, message.data, publish_ns=message.publish_ns)

    def close(self) -> None:
        """Write index, footer and, in a folder, metadata.yaml. A second call does nothing.

        Raises:
            BagError: the disk refuses; the chunks written before can still be read.

        """
        self._close(whole=True)

    def _close(self, *, whole: bool) -> None:
        mcap, self._mcap = self._mcap, None
        if mcap is None:
            return
        try:
            try:
                mcap.finish()  # type: ignore[no-untyped-call]  # mcap leaves it without annotations
            finally:
                self._stream.close()
            if self._folder is not None:
                # Renamed into place, so that a folder has all of its metadata or none.
                partial = self._folder / "metadata.yaml.partial"
                partial.write_text(_to_yaml(self._metadata()), encoding="utf-8")
                partial.replace(self._folder / "metadata.yaml")
            if self._aside is not None and whole:
                publish(self._aside, self.path)
        except FileExistsError as error:
            raise BagError(
                f"expected to replace {self.path} (got one that another process has written meanwhile)"
            ) from error
        except OSError as error:
            raise BagError(f"expected room for a bag at {self.path} (got {error})") from error
        finally:
            if self._aside is not None:  # gone already where it has taken its place
                remove(self._aside)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._close(whole=error is None)
        except BagError as closing:
            if error is None:
                raise
            _LOG.warning("bag %s was not closed: %s", self.path, closing)

    def _add_topic(self, mcap: Writer, topic: str, type_: str) -> _Topic:
        from rosbags.typesys import TypesysError

        try:
            definition, _ = typestore().generate_msgdef(type_, ros_version=2)
            type_hash = typestore().hash_rihs01(type_)
        except (TypesysError, KeyError) as error:
            raise BagError(f"expected a message type of ROS 2 Jazzy on {topic} (got {type_!r})") from error
        if type_ not in self._schemas:
            self._schemas[type_] = mcap.register_schema(type_, "ros2msg", definition.encode())
        channel = mcap.register_channel(
            topic,
            "cdr",
            self._schemas[type_],
            {
                "offered_qos_profiles": _to_yaml([_qos(topic)]).strip(),
                "topic_type_hash": type_hash,
            },
        )
        self._counts[topic] = 0
        self._topics[topic] = _Topic(channel, type_, type_hash)
        return self._topics[topic]

    def _metadata(self) -> dict[str, Any]:
        count = sum(self._counts.values())
        span = {
            "duration": {"nanoseconds": self._end_ns - self._start_ns if count else 0},
            "starting_time": {"nanoseconds_since_epoch": self._start_ns if count else 0},
            "message_count": count,
        }
        topics = [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [_qos(name)],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": self._counts[name],
            }
            for name, topic in self._topics.items()
        ]
        information = {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": topics,
            # Chunks are compressed inside the mcap file, which is not what rosbag2 means by these two.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file.name],
            "files": [{"path": self.file.name, **span}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
        return {"rosbag2_bagfile_information": information}
