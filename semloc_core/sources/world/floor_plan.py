"""Floor plans: rectangular rooms on both sides of straight corridors, joined by doors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from semloc_core.text import short_repr

Point = tuple[float, float]

CORRIDOR = "corridor"
FIRST_WIDTH_M = 1.0


class RoomKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``count`` rooms of one kind: ``width_m`` along the corridor drawn between two bounds, ``door_m`` its door's."""

    name: str
    count: int
    width_m: tuple[float, float]
    door_m: float = 1.0


@dataclass(frozen=True)
class Room:
    """An axis-aligned rectangle from ``low`` to ``high`` (m); ``kind`` is a room kind's name or ``corridor``."""

    name: str
    kind: str
    low: Point
    high: Point


@dataclass(frozen=True)
class Door:
    """An opening in the wall that two rooms (indices) share: its centre, the wall's axis and its width (m)."""

    rooms: tuple[int, int]
    centre: Point
    axis: int
    width: float


@short_repr
@dataclass(frozen=True)
class FloorPlan:
    """Rooms and the doors between them."""

    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]


def corridor_plan(
    kinds: Sequence[RoomKind],
    rng: np.random.Generator,
    *,
    wings: int,
    depth_m: float,
    corridor_m: float,
    passages: float,
    passage_m: float,
) -> FloorPlan:
    """Lay rooms out along the corridors of one or more wings.

    Each wing is a corridor with rooms on either side; wings lie one above the other and a cross-corridor at the left
    joins them. Rooms come in random order, each to the row that is shortest so far; each has a door to its corridor,
    and some have an opening to the next room of the row.

    Args:
        kinds: which rooms.
        rng: source of order, widths, doors and openings.
        wings: number of corridors.
        depth_m: depth of the rooms, from corridor to outer wall.
        corridor_m: width of the corridors.
        passages: probability that neighbouring rooms are joined.
        passage_m: width of the openings between them.

    """
    wanted = [kind for kind in kinds for _ in range(kind.count)]
    order = rng.permutation(len(wanted))
    ends = [0.0] * (2 * wings)
    placed: list[tuple[int, RoomKind, float, float]] = []
    for i in order:
        row = int(np.argmin(ends))
        width = float(rng.uniform(*wanted[i].width_m))
        placed.append((row, wanted[i], ends[row], ends[row] + width))
        ends[row] += width

    pitch = 2 * depth_m + corridor_m
    rooms: list[Room] = []
    doors: list[Door] = []
    for wing in range(wings):
        low = wing * pitch + depth_m
        length = max(ends[2 * wing], ends[2 * wing + 1], FIRST_WIDTH_M)
        rooms.append(Room(f"{CORRIDOR} {wing}", CORRIDOR, (0.0, low), (length, low + corridor_m)))
    if wings > 1:
        rooms.append(Room(f"{CORRIDOR} {wings}", CORRIDOR, (-corridor_m, 0.0), (0.0, wings * pitch)))
        for wing in range(wings):
            middle = wing * pitch + depth_m + corridor_m / 2
            doors.append(Door((wing, wings), (0.0, middle), axis=1, width=corridor_m))
    numbers: dict[str, int] = {}
    latest: dict[int, int] = {}
    for row, kind, left, right in placed:
        wing, above = divmod(row, 2)
        wall = wing * pitch + depth_m + above * corridor_m
        low_y, high_y = (wall, wall + depth_m) if above else (wall - depth_m, wall)
        index, number = len(rooms), numbers.get(kind.name, 0)
        rooms.append(Room(f"{kind.name} {number}", kind.name, (left, low_y), (right, high_y)))
        numbers[kind.name] = number + 1
        door = min(kind.door_m, right - left - 0.4)
        centre = left + 0.2 + door / 2 + float(rng.random()) * max(0.0, right - left - 0.4 - door)
        doors.append(Door((index, wing), (centre, wall), axis=0, width=door))
        if row in latest and rng.random() < passages:
            opening = min(passage_m, depth_m)
            centre = low_y + opening / 2 + float(rng.random()) * (depth_m - opening)
            doors.append(Door((index, latest[row]), (left, centre), axis=1, width=opening))
        latest[row] = index
    return FloorPlan(tuple(rooms), tuple(doors))
