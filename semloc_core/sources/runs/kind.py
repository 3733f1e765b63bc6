"""What is a run, and on which topics of a bag its updates are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import msgspec

from semloc_core import wire
from semloc_core.sources.bag import (
    STRING,
    BagReader,
    decode_string,
)
from semloc_core.sources.bag.kinds import kind_of

_LOOKED_AT = 100
"""Messages of a topic that are looked at, to see whether it has updates."""
_SUFFIXES = (".mcap", ".db3", ".jsonl", ".ndjson", ".mcap.zstd", ".db3.zstd")
_SCHEMA = "semloc/scene_graph_update/"


def is_run(path: Path) -> bool:
    """Whether an input is a run rather than a graph file, by its content; by its name where there is no such file."""
    if path.is_dir() or path.name.endswith(_SUFFIXES):
        return True
    return path.is_file() and (kind_of(path) is not None or is_update(_first_line(path)))


def _first_line(path: Path) -> bytes:
    with path.open("rb") as file:
        for line in iter(lambda: file.readline(wire.MAX_BYTES), b""):
            if line.strip():
                return line.removeprefix(b"\xef\xbb\xbf")
    return b""


class _Schema(msgspec.Struct):
    schema: str = ""


_SCHEMA_OF = msgspec.json.Decoder(_Schema)


def is_update(text: bytes | str) -> bool:
    """Whether a text says of itself that it is a scene-graph update."""
    try:
        return _SCHEMA_OF.decode(text).schema.startswith(_SCHEMA)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return False


def robots_of(topics: list[str]) -> dict[str, str] | None:
    """Robot -> topic, where topics differ in one name of their namespace only; None where they do not.

    The robot of a topic without that namespace is called by its topic.
    """
    parts = [topic.strip("/").split("/") for topic in topics]
    last = {row[-1] for row in parts}
    if len(last) > 1:
        return None
    if len({len(row) for row in parts}) > 1:
        return {"/".join(row[:-1]) or topic: topic for row, topic in zip(parts, topics, strict=True)}
    differing = [n for n in range(len(parts[0])) if len({row[n] for row in parts}) > 1]
    if len(differing) != 1:
        return None
    return {row[differing[0]]: topic for row, topic in zip(parts, topics, strict=True)}


def topics_of(path: Path) -> dict[str, str]:
    """Topic -> type of all topics of a bag; where an mcap file has its summary, nothing else is read."""
    if path.is_file() and kind_of(path) == "mcap":
        from mcap.reader import make_reader

        try:
            with path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except Exception:
            # No summary, or a broken one: mcap raises errors of its own, struct.error, ValueError and others.
            summary = None
        if summary is not None and summary.channels and summary.statistics is not None:
            counts: Mapping[int, int] = summary.statistics.channel_message_counts
            types = {c.id: summary.schemas.get(c.schema_id) for c in summary.channels.values()}
            return {
                c.topic: (schema.name if (schema := types[c.id]) is not None else "")
                for c in summary.channels.values()
                if counts.get(c.id)
            }
    reader = BagReader(path, (), quiet=True)
    for _ in reader:
        pass
    return reader.types


def with_updates(path: Path, topics: list[str]) -> list[str]:
    """Those of some topics of text on which updates are."""
    found: list[str] = []
    looked: Counter[str] = Counter()
    if topics:
        for message in BagReader(path, dict.fromkeys(topics, STRING), quiet=True):
            if message.topic not in found and looked[message.topic] < _LOOKED_AT:
                looked[message.topic] += 1
                if is_update(decode_string(message.data)):
                    found.append(message.topic)
            if all(topic in found or looked[topic] >= _LOOKED_AT for topic in topics):
                break
    return found
