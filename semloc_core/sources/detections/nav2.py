"""What a robot with nav2 has already: a saved map as nav2_map_server reads it, and a list of what stands where."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from semloc_core.errors import FileFormatError
from semloc_core.graph import Floats, SceneGraph
from semloc_core.sources.detections.grid import Grid, free_places
from semloc_core.sources.hydra.write import node_id
from semloc_core.wire import Object, Place, Position, SceneGraphUpdate, one_line

MODES = ("trinary", "scale", "raw")
OCCUPIED, UNKNOWN = 100, -1
MAX_PIXELS = 100_000_000
REACH_M = 4.0
"""An object further from all places has none."""
_NAMES = {"class": ("class", "label", "class_id", "name"), "x": ("x",), "y": ("y",), "z": ("z",)}
_SIZES = (("size_x", "size_y", "size_z"), ("sx", "sy", "sz"), ("width", "depth", "height"))


def read_nav2(path: str | Path) -> Grid:
    """Read a saved map as nav2_map_server's map_io does.

    The image's upper row is the grid's last; a pixel is as bright as its channels' mean (in mode trinary with its
    opacity among them). In mode scale what is not opaque is unknown; raw takes brightness itself, negate or not.

    Args:
        path: the YAML: image, resolution, origin, occupied_thresh, free_thresh, negate, mode.

    Raises:
        FileFormatError: the YAML lacks one of these, or has one that is none; there is no such image.

    """
    path = Path(path)
    document = _document(path)
    image = _get(document, path, "image", str)
    origin = document.get("origin")
    if not (isinstance(origin, list) and len(origin) == 3):
        raise FileFormatError(f"expected origin [x, y, yaw] in {path} (got {one_line(repr(origin))})")
    x, y, yaw = (_number(value, path, "origin") for value in origin)
    resolution, free, occupied = (
        _number(_get(document, path, key, object), path, key)
        for key in ("resolution", "free_thresh", "occupied_thresh")
    )
    if resolution <= 0:
        raise FileFormatError(f"expected a resolution above 0 in {path} (got {resolution:g})")
    mode = str(document.get("mode", MODES[0])).lower()
    if mode not in MODES:
        raise FileFormatError(f"expected mode {', '.join(MODES)} in {path} (got {one_line(repr(mode))})")
    negate = _get(document, path, "negate", object)
    if not isinstance(negate, int):
        raise FileFormatError(f"expected negate 0 or 1 in {path} (got {one_line(repr(negate))})")
    colours, opacity = _image(path.parent / image)
    cells = occupancy(colours, opacity, mode, bool(negate), free, occupied)
    return Grid(np.ascontiguousarray(cells[::-1]), resolution, (x, y, yaw))


def occupancy(
    colours: Floats, opacity: Floats | None, mode: str, negate: bool, free: float, occupied: float
) -> np.ndarray[Any, np.dtype[np.int8]]:
    """(H, W) int8 percentages out of (H, W, 3) colours and (H, W) opacity, all 0 … 1; -1: unknown."""
    total, channels = colours.sum(axis=2), 3
    if mode == "trinary" and opacity is not None:
        total, channels = total + opacity, 4
    shade = total / channels
    if mode == "raw":
        percent = np.floor(shade * 255 + 0.5)
        return np.where(percent <= OCCUPIED, percent, UNKNOWN).astype(np.int8)
    taken = shade if negate else 1.0 - shade
    between = np.full_like(taken, UNKNOWN)
    if mode == "scale" and occupied > free:
        between = np.rint((taken - free) / (occupied - free) * 100.0)
    cells = np.where(occupied < taken, OCCUPIED, np.where(taken < free, 0.0, between))
    if mode == "scale" and opacity is not None:
        cells = np.where(opacity < 1.0, UNKNOWN, cells)
    return cells.astype(np.int8)


def _image(path: Path) -> tuple[Floats, Floats | None]:
    """Colours and opacity, 0 … 1, of whatever Pillow reads: PGM, PNG, BMP, JPEG."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_PIXELS:
                raise FileFormatError(f"expected at most {MAX_PIXELS} pixels in {path} (got {image.size})")
            if image.mode.startswith("I"):  # 16 bits of grey
                grey = np.asarray(image, dtype=np.float64) / 65535
                return np.repeat(grey[..., None], 3, axis=2), None
            see_through = image.mode in ("LA", "PA", "RGBA", "La", "RGBa") or "transparency" in image.info
            pixels = np.asarray(image.convert("RGBA" if see_through else "RGB"), dtype=np.float64) / 255
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FileFormatError(f"expected the map's image at {path} (got: {one_line(str(error))})") from error
    return pixels[..., :3], pixels[..., 3] if see_through else None


def read_objects(path: str | Path) -> list[tuple[str, Position, Position | None]]:
    """Read a list of objects: (class, position, size), metres, in the grid's frame.

    CSV has a header: class, x, y, z and, where sizes are known, size_x, size_y, size_z, or size for cubes. YAML and
    JSON have a list of such records (or one under ``objects``), where position and size may be lists of three.

    Raises:
        FileFormatError: a record lacks one of these, or has one that is none; the line names it.

    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"expected a list of objects at {path} (got: {one_line(str(error))})") from error
    rows: Any
    if path.suffix.lower() == ".csv":
        rows = _rows(path, text)
    else:
        found = _parsed(path, text)
        found = found.get("objects") if isinstance(found, dict) else found
        if not isinstance(found, list):
            got = "text; is it CSV? its name then ends in .csv" if isinstance(found, str) else type(found).__name__
            raise FileFormatError(f"expected a list of objects in {path} (got {got})")
        rows = [(f"object {i + 1}", row) for i, row in enumerate(found)]
    return [_object(row, f"{path}, {where}") for where, row in rows]


def _rows(path: Path, text: str) -> list[tuple[str, dict[str, str]]]:
    """Of a CSV file with a header: where each record is, and its fields."""
    try:
        reader = csv.reader(io.StringIO(text), skipinitialspace=True)
        header = _lower(next(reader, ()))
        rows = [(f"line {reader.line_num}", row) for row in reader if any(field.strip() for field in row)]
    except csv.Error as error:
        raise FileFormatError(f"expected CSV in {path} (got: {one_line(str(error))})") from error
    if any(not {*names} & {*header} for names in _NAMES.values()):
        got = one_line(", ".join(header)) or "none"
        other = next(
            (name for name, sign in (("semicolons", ";"), ("tabs", "\t")) if sign in got.replace("\\t", "\t")), ""
        )
        hint = f"; commas part fields, not {other}, and points decimals" if other else ""
        raise FileFormatError(f"expected a header with class, x, y, z in {path} (got {got}{hint})")
    if len({*filter(None, header)}) < len([*filter(None, header)]):
        raise FileFormatError(f"expected each column once in {path} (got {one_line(', '.join(header))})")
    for where, row in rows:
        if len(row) > len(header) and any(field.strip() for field in row[len(header) :]):
            raise FileFormatError(
                f"expected {len(header)} fields, as the header has, in {path}, {where} (got {len(row)}; decimals have "
                "points, names with commas quotes)"
            )
    return [(where, dict(zip(header, row, strict=False))) for where, row in rows]


def _lower(names: Iterable[Any]) -> list[str]:
    return [str(name).strip().lower() for name in names]


def _object(row: Any, where: str) -> tuple[str, Position, Position | None]:
    if not isinstance(row, Mapping):
        raise FileFormatError(f"expected a record with class, x, y, z in {where} (got {one_line(repr(row))})")
    fields = {str(key).strip().lower(): value for key, value in row.items() if value not in (None, "")}
    named = next((fields[name] for name in _NAMES["class"] if name in fields), "")
    class_ = str(named).strip()
    if not class_:
        raise FileFormatError(f"expected a class in {where} (got none)")
    if isinstance(named, bool | list | dict) or any(ord(sign) < ord(" ") for sign in class_):
        hint = "; YAML takes yes and no for truth: quote it" if isinstance(named, bool) else ""
        raise FileFormatError(f"expected a name for a class in {where} (got {one_line(repr(named))}{hint})")
    position = fields.get("position", [fields.get(axis) for axis in "xyz"])
    size = fields.get("size")
    if size is None:
        size = next(([fields[name] for name in names] for names in _SIZES if fields.keys() >= {*names}), None)
    elif isinstance(size, str):
        size = size.strip("[]() ").replace(",", " ").replace("x", " ").split()
        size = size * 3 if len(size) == 1 else size
    elif not isinstance(size, list | dict):
        size = [size] * 3
    dimensions = None if size is None else _three(size, where, "a size")
    if dimensions is not None and min(dimensions) < 0:
        raise FileFormatError(f"expected a size of 0 m and more in {where} (got {dimensions})")
    return class_, _three(position, where, "x, y, z"), dimensions


def _three(values: Any, where: str, what: str) -> Position:
    if isinstance(values, dict) and values.keys() == {*"xyz"}:
        values = [values[axis] for axis in "xyz"]
    if not isinstance(values, list) or len(values) != 3:
        raise FileFormatError(f"expected three numbers for {what} in {where} (got {one_line(repr(values))})")
    a, b, c = (_number(value, where, what) for value in values)
    return a, b, c


def _number(value: Any, where: Path | str, what: str) -> float:
    try:
        found = float("nan" if isinstance(value, bool) else value)
    except (TypeError, ValueError):
        found = float("nan")
    if not abs(found) <= 1e9:
        raise FileFormatError(f"expected a number for {what} in {where} (got {one_line(repr(value))})")
    return found


def _document(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"expected a map of nav2 at {path} (got: {one_line(str(error))})") from error
    found = _parsed(path, text)
    if not isinstance(found, dict):
        raise FileFormatError(f"expected a map of nav2 in {path}: image, resolution, origin (got none of them)")
    return found


def _parsed(path: Path, text: str) -> Any:
    try:
        # JSON is YAML, but for the tabs that it may be laid out with.
        return json.loads(text) if path.suffix.lower() == ".json" else yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise FileFormatError(f"expected YAML or JSON in {path} (got: {one_line(str(error))})") from error


def _get(document: Mapping[str, Any], path: Path, key: str, type_: type) -> Any:
    value = document.get(key)
    if value is None or not isinstance(value, type_) or value == "":
        raise FileFormatError(f"expected {key} in {path} (got {one_line(repr(value))})")
    return value


def graph_of(
    grid: Grid, objects: Iterable[tuple[str, Position, Position | None]], *, spacing_m: float, radius_m: float
) -> tuple[SceneGraph, list[int]]:
    """A scene graph in the grid's frame: places on the floor of its free space, objects on the nearest in sight.

    Args:
        grid: the grid.
        objects: as `read_objects` gives them.
        spacing_m: between places.
        radius_m: of the robot.

    Returns:
        The graph; the objects, by number, that are further than `REACH_M` from all places and so left out.

    Raises:
        GraphError: the robot fits nowhere.

    """
    space = free_places(grid, spacing_m, radius_m)
    places = [node_id("p", i) for i in range(len(space.points))]
    kept, links, left = [], [], []
    for i, (class_, position, size) in enumerate(objects):
        parent = hung(grid, space.points, position, size)
        if parent is None:
            left.append(i)
            continue
        kept.append(Object(node_id("O", i), class_, position, size))
        links.append((places[parent], kept[-1].id))
    update = SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=0,
        frame_id="map",
        seq=0,
        full=True,
        places=[Place(key, (x, y, 0.0)) for key, (x, y) in zip(places, space.points.tolist(), strict=True)],
        objects=kept,
        edges=[(places[a], places[b]) for a, b in space.edges.T.tolist()] + links,
        query_place=None,
    )
    return SceneGraph.from_update(update), left


def hung(grid: Grid, points: Floats, position: Position, size: Position | None) -> int | None:
    """The place (of (N, 2), m) that an object hangs on: the nearest in sight; else the nearest; None out of reach."""
    away = np.linalg.norm(points - np.array(position[:2]), axis=1)
    near = np.flatnonzero(away <= REACH_M)
    if not len(near):
        return None
    near = near[np.argsort(away[near], kind="stable")]
    ends = np.broadcast_to(np.array(position[:2]), (len(near), 2))
    seen = near[grid.sight(points[near], ends, short(size))]
    return int(seen[0] if len(seen) else near[0])


def short(size: Position | None) -> float:
    """How far before its middle an object ends, m: it may stand in cells that are occupied, by itself."""
    return 0.3 + (0.5 * max(size[:2]) if size is not None else 0.0)
