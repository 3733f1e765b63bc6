"""What a file is, by what is in it: a name can say anything."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec

APPLICATION_ID = 0x53454D4C
"""``SEML``, in the header of every map file."""

MAP = "a map"
BAG = "a bag"
MODEL = "a model"
STATE = "a training state"
GRAPH = "a scene graph"
FIGURES = "figures as JSON"
MESSAGES = "messages as JSON"
STUDY = "a kept study"
CALIBRATION = "a calibration"
PAGE = "an HTML page"
PICTURE = "a picture"
TRAJECTORY = "a trajectory"
EMPTY = "an empty file"
FOLDER = "a folder"

_HEAD_BYTES = 4096
_JSON_BYTES = 512 * 2**20
_PICTURES = (b"\x89PNG\r\n\x1a\n", b"%PDF-", b"\xff\xd8\xff")
_UPDATE = "semloc/scene_graph_update/"


def kind_of(path: Path) -> str:
    """What an existing file or folder is, with its article; ``something else`` where it is nothing of ours.

    Raises:
        OSError: it can't be read.

    """
    if path.is_dir():
        inside = {each.suffix for each in path.iterdir()}
        return BAG if (path / "metadata.yaml").exists() or inside & {".mcap", ".db3"} else FOLDER
    if not path.is_file():
        return "a device"
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        return EMPTY
    if head.startswith(b"\x89MCAP0\r\n"):
        return BAG
    if head.startswith(b"SQLite format 3\0"):
        return MAP if int.from_bytes(head[68:72], "big") == APPLICATION_ID else _database(path)
    if head.startswith(b"PK\x03\x04"):  # an archive, by the name of its first member
        first = head[30 : 30 + int.from_bytes(head[26:28], "little")]
        return MODEL if first == b"header.json" else STATE if first.endswith(b"/data.pkl") else "an archive"
    if head.startswith(_PICTURES):
        return PICTURE
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if re.match(rb"<!doctype html|<html", start, re.IGNORECASE):
        return PAGE
    if start.startswith((b"<svg", b"<?xml")) and b"<svg" in head:
        return PICTURE
    if start.startswith((b"{", b"[")):
        return _json(path)
    return _text(head)


def other_kind(path: Path, wanted: str) -> str | None:
    """What a file is where it is surely one of ours and not what is wanted; None where that can't be said.

    Raises:
        OSError: it can't be read.

    """
    kind = kind_of(path)
    return kind if kind in _SURE and kind != wanted else None


def _database(path: Path) -> str:
    """A rosbag2 of SQLite, or another database."""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    except sqlite3.Error:
        tables = set()
    return BAG if {"topics", "messages"} <= tables else "a database of something else"


def _json(path: Path) -> str:
    if path.stat().st_size > _JSON_BYTES:
        return "JSON of something else"
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf").strip()
    try:
        if data.startswith(b"["):
            many = msgspec.json.decode(data, type=list[dict[str, msgspec.Raw]])
            return MESSAGES if many and all(_says(one, "schema", "semloc/") for one in many) else _OTHER
        keys = msgspec.json.decode(data, type=dict[str, msgspec.Raw])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        first, more, _ = data.partition(b"\n")
        return BAG if more and f'"{_UPDATE}'.encode() in first[:200] else "text"  # one update a line
    found = [kind for kind, names in _KEYS.items() if names <= keys.keys()]
    if found:
        return found[0]
    if _says(keys, "format", "semloc/page/"):
        return STUDY
    return MESSAGES if _says(keys, "schema", "semloc/") else _OTHER


def _says(document: dict[str, msgspec.Raw], key: str, start: str) -> bool:
    return bytes(document.get(key, b"")).startswith(f'"{start}'.encode())


_KEYS = {FIGURES: {"command", "rows"}, GRAPH: {"nodes", "edges"}, CALIBRATION: {"right", "in_map"}}
_OTHER = "JSON of something else"
_SURE = {MAP, BAG, MODEL, STATE, GRAPH, FIGURES, MESSAGES, STUDY, CALIBRATION, PAGE, PICTURE, TRAJECTORY, FOLDER}


def _text(head: bytes) -> str:
    """Lines of a stamp and seven numbers are a trajectory as TUM has it."""
    try:
        lines = head.decode().split("\n")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # not a character cut off by the end
            return "something else"
        lines = head[: error.start].decode().split("\n")
    rows = [line.split() for line in lines[:-1] if line.strip() and not line.startswith("#")]
    try:
        numbers = [[float(word) for word in row] for row in rows]
    except ValueError:
        return "text"
    only_a_head = not rows and lines[0].startswith("#") and "tx" in lines[0]
    return TRAJECTORY if only_a_head or (numbers and all(len(row) == 8 for row in numbers)) else "text"
