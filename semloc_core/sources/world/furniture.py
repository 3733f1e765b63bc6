"""Furniture: what stands where, in groups as people put them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from semloc_core.errors import ConfigError
from semloc_core.sources.world.floor_plan import Door, FloorPlan, Point, Room

ATTEMPTS = 60

Where = Literal["wall", "floor", "door", "beside"]


class Furniture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """How the objects of one class are placed.

    ``count`` objects are dealt to rooms of the kinds in ``rooms``, ``per_room`` (drawn between two bounds) to one
    room after another, in random order, until none is left.

    ``where``: ``wall``: along a wall; ``floor``: anywhere; ``door``: just inside a door; ``beside``: near an object
    of the class ``beside`` that none of this class stands near yet (so ``count`` can't exceed theirs).
    ``group_m``: objects of this class in one room stand within this distance of the first (``wall``, ``floor``).
    ``size`` is the object's box, ``height_m`` its centre's height, ``footprint`` the floor it and what it stands on
    take up (along the wall, away from it). Metres.
    """

    class_: str
    count: int
    where: Where
    size: tuple[float, float, float]
    height_m: float
    rooms: tuple[str, ...] = ()
    per_room: tuple[int, int] = (1, 1)
    beside: str | None = None
    group_m: float = 100.0
    footprint: tuple[float, float] | None = None


@dataclass(frozen=True)
class Item:
    """One object: class, index of its room, centre (m), box (m) and the half extents of its footprint (m)."""

    class_: str
    room: int
    position: tuple[float, float, float]
    size: tuple[float, float, float]
    half: Point


def furnish(plan: FloorPlan, furniture: Sequence[Furniture], rng: np.random.Generator) -> list[Item]:
    """Place every class's objects, in the order given, without footprints that overlap or block a door.

    Raises:
        ConfigError: a class has nowhere to go, or there is no space left for it.

    """
    items: list[Item] = []
    for kind in furniture:
        if kind.where == "beside":
            _place_beside(plan, kind, items, rng)
        else:
            _place_in_rooms(plan, kind, items, rng)
    return items


def _place_in_rooms(plan: FloorPlan, kind: Furniture, items: list[Item], rng: np.random.Generator) -> None:
    rooms = [i for i, room in enumerate(plan.rooms) if room.kind in kind.rooms]
    if kind.count and not rooms:
        raise ConfigError(f"expected a room of kind {' or '.join(kind.rooms)} for {kind.class_} (got none)")
    left = kind.count
    failures = 0
    turn: list[int] = []
    while left:
        turn = turn or [rooms[i] for i in rng.permutation(len(rooms))]
        room = turn.pop()
        first: Point | None = None
        for _ in range(min(left, int(rng.integers(kind.per_room[0], kind.per_room[1] + 1)))):
            item = _try(plan, room, kind, items, first, rng)
            if item is None:
                failures += 1
                break
            first = first or item.position[:2]
            items.append(item)
            left -= 1
        if failures > 4 * len(rooms):
            raise ConfigError(f"expected room for {kind.count} of {kind.class_} (got {kind.count - left} placed)")


def _place_beside(plan: FloorPlan, kind: Furniture, items: list[Item], rng: np.random.Generator) -> None:
    hosts = [h for h in items if h.class_ == kind.beside and (not kind.rooms or plan.rooms[h.room].kind in kind.rooms)]
    if len(hosts) < kind.count:
        raise ConfigError(f"expected at least {kind.count} of {kind.beside} beside {kind.class_} (got {len(hosts)})")
    left = kind.count
    for i in rng.permutation(len(hosts)):
        if not left:
            break
        item = _try(plan, hosts[i].room, kind, items, None, rng, hosts[i])
        if item is not None:
            items.append(item)
            left -= 1
    if left:
        raise ConfigError(f"expected room for {kind.count} of {kind.class_} (got {kind.count - left} placed)")


def _try(
    plan: FloorPlan,
    room_index: int,
    kind: Furniture,
    items: Sequence[Item],
    first: Point | None,
    rng: np.random.Generator,
    host: Item | None = None,
) -> Item | None:
    """Draw positions until one is free."""
    room = plan.rooms[room_index]
    doors = [d for d in plan.doors if room_index in d.rooms]
    others = [other for other in items if other.room == room_index]
    along, away = kind.footprint or kind.size[:2]
    for _ in range(ATTEMPTS):
        axis = int(rng.integers(2))
        half = (along / 2, away / 2) if axis == 0 else (away / 2, along / 2)
        if host is not None:
            centre = _beside(host, half, rng)
        elif kind.where == "door":
            centre = _at_door(room, doors[int(rng.integers(len(doors)))], half, rng)
        else:
            centre = _inside(room, half, axis, kind.where == "wall", rng)
        free = (
            _contains(room, centre, half)
            and (first is None or np.hypot(centre[0] - first[0], centre[1] - first[1]) <= kind.group_m)
            and not any(_overlap(centre, half, other.position[:2], other.half) for other in others)
            and not any(_blocks(centre, half, door) for door in doors)
        )
        if free:
            return Item(kind.class_, room_index, (*centre, kind.height_m), kind.size, half)
    return None


def _inside(room: Room, half: Point, axis: int, wall: bool, rng: np.random.Generator) -> Point:
    """A point of the room, at one of the two walls that run along ``axis`` where ``wall``."""
    low, high = np.array(room.low) + half, np.array(room.high) - half
    point = rng.uniform(low, np.maximum(low, high))
    if wall:
        point[1 - axis] = (low, high)[int(rng.integers(2))][1 - axis]
    return float(point[0]), float(point[1])


def _at_door(room: Room, door: Door, half: Point, rng: np.random.Generator) -> Point:
    """Against the door's wall, to its left or right."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    middle = (room.low[1 - door.axis] + room.high[1 - door.axis]) / 2
    inwards = 1.0 if middle > door.centre[1 - door.axis] else -1.0
    point = np.array(door.centre)
    point[door.axis] += side * (door.width / 2 + half[door.axis] + rng.uniform(0.05, 0.4))
    point[1 - door.axis] += inwards * half[1 - door.axis]
    return float(point[0]), float(point[1])


def _beside(host: Item, half: Point, rng: np.random.Generator) -> Point:
    """Touching the host's footprint, on a random side of it."""
    axis, sign = int(rng.integers(2)), (1.0 if rng.random() < 0.5 else -1.0)
    point = np.array(host.position[:2])
    point[axis] += sign * (host.half[axis] + half[axis] + 0.02)
    point[1 - axis] += rng.uniform(-0.3, 0.3)
    return float(point[0]), float(point[1])


def _contains(room: Room, centre: Point, half: Point) -> bool:
    return all(
        low + h <= c + 1e-9 and c <= high - h + 1e-9
        for low, high, c, h in zip(room.low, room.high, centre, half, strict=True)
    )


def _overlap(a: Point, a_half: Point, b: Point, b_half: Point) -> bool:
    return abs(a[0] - b[0]) < a_half[0] + b_half[0] and abs(a[1] - b[1]) < a_half[1] + b_half[1]


def _blocks(centre: Point, half: Point, door: Door) -> bool:
    """Whether a footprint stands in front of a door."""
    clear = door.width / 2
    return _overlap(centre, half, door.centre, (clear, 0.7) if door.axis == 0 else (0.7, clear))
