"""What homes and offices have in them: rooms, and furniture by the names that detectors give it."""

from __future__ import annotations

from typing import Literal

from semloc_core.sources.world.floor_plan import CORRIDOR, RoomKind
from semloc_core.sources.world.furniture import Furniture, Where
from semloc_core.sources.world.kinds import BuildingKind, Rooms, Thing

Box = tuple[float, float, float]
KindName = Literal["home", "coco_office", "office"]


def _rooms(name: str, count: tuple[int, int], width_m: tuple[float, float], door_m: float = 0.9) -> Rooms:
    return Rooms(RoomKind(name, 0, width_m, door_m), count)


def _one(class_: str, share: float, rooms: str, size: Box, height_m: float, where: Where = "wall") -> Thing:
    """One in a room, with a probability; rooms are separated by commas."""
    return Thing(Furniture(class_, 0, where, size, height_m, rooms=tuple(rooms.split(","))), share, usual=True)


def _some(
    class_: str,
    mean: float,
    rooms: str,
    size: Box,
    height_m: float,
    group: tuple[int, int] = (1, 1),
    near_m: float = 9.0,
) -> Thing:
    """Along walls, so many a room on average, in groups of so many within so many metres."""
    names = tuple(rooms.split(","))
    return Thing(Furniture(class_, 0, "wall", size, height_m, rooms=names, per_room=group, group_m=near_m), mean)


def _around(class_: str, mean: float, rooms: str, group: tuple[int, int], near_m: float) -> Thing:
    """Seats in the middle of a room."""
    names, size = tuple(rooms.split(",")), (0.5, 0.5, 0.9)
    return Thing(Furniture(class_, 0, "floor", size, 0.45, rooms=names, per_room=group, group_m=near_m), mean)


def _beside(class_: str, share: float, host: str, size: Box, height_m: float) -> Thing:
    """Next to a share of another class's objects, on which or by which it stands."""
    return Thing(Furniture(class_, 0, "beside", size, height_m, beside=host), share)


SMALL: Box = (0.12, 0.12, 0.2)
FLAT: Box = (0.3, 0.2, 0.05)
LIVED_IN = "living room,bedroom,study,dining room"

HOME = BuildingKind(
    labelspace="coco",
    rooms=(
        _rooms("living room", (1, 2), (4.5, 7.5), 1.6),
        _rooms("kitchen", (1, 1), (3.2, 4.8), 1.2),
        _rooms("dining room", (0, 1), (3.4, 4.8), 1.4),
        _rooms("bedroom", (1, 6), (3.2, 5.0)),
        _rooms("bathroom", (1, 5), (1.9, 3.2), 0.8),
        _rooms("study", (0, 2), (2.8, 4.0)),
        _rooms("storage", (0, 2), (1.8, 3.0), 0.8),
    ),
    things=(
        _one("bed", 0.95, "bedroom", (2.0, 1.6, 0.6), 0.4),
        _one("dining table", 0.9, "dining room", (1.6, 0.9, 0.75), 0.4, "floor"),
        _one("dining table", 0.4, "kitchen,living room", (1.1, 0.8, 0.75), 0.4, "floor"),
        _some("couch", 1.6, "living room", (1.9, 0.9, 0.8), 0.4, (1, 3), 3.5),
        _some("couch", 0.15, "bedroom,study", (1.5, 0.8, 0.8), 0.4),
        _one("oven", 0.9, "kitchen", (0.6, 0.6, 0.9), 0.5),
        _one("refrigerator", 0.9, "kitchen", (0.7, 0.7, 1.7), 0.9),
        _one("microwave", 0.6, "kitchen", (0.5, 0.4, 0.3), 1.2),
        _one("toaster", 0.2, "kitchen", SMALL, 1.0),
        _one("sink", 0.9, "kitchen,bathroom", (0.6, 0.5, 0.3), 0.85),
        _one("toilet", 0.9, "bathroom", (0.7, 0.4, 0.8), 0.4),
        _some("sink", 0.2, "bathroom,storage", (0.6, 0.5, 0.3), 0.85),
        _around("chair", 4.0, "dining room", (3, 8), 2.2),
        _around("chair", 1.5, "living room,kitchen", (1, 5), 2.2),
        _some("chair", 0.8, "bedroom,study", (0.5, 0.5, 0.9), 0.45, (1, 2)),
        _one("tv", 0.7, "living room", (1.1, 0.2, 0.7), 1.2),
        _one("tv", 0.25, "bedroom", (0.9, 0.2, 0.6), 1.3),
        _some("potted plant", 1.3, f"{LIVED_IN},{CORRIDOR},kitchen", (0.4, 0.4, 0.8), 0.6, (1, 4), 2.0),
        _some("vase", 0.8, f"{LIVED_IN},kitchen,{CORRIDOR}", SMALL, 1.0, (1, 4), 1.5),
        _some("book", 0.8, LIVED_IN, FLAT, 1.1, (1, 7), 1.5),
        _some("bottle", 1.2, "kitchen,bathroom,dining room", SMALL, 1.0, (1, 6), 1.2),
        _some("bowl", 0.9, "kitchen,dining room", SMALL, 1.0, (1, 4), 1.5),
        _some("cup", 0.6, "kitchen,dining room,study", SMALL, 1.0, (1, 3), 1.5),
        _some("wine glass", 0.4, "kitchen,dining room", SMALL, 1.0, (1, 4), 1.0),
        _some("clock", 0.2, f"{LIVED_IN},kitchen,{CORRIDOR}", (0.3, 0.1, 0.3), 1.8),
        _some("laptop", 0.3, "study,bedroom,living room", FLAT, 0.8),
        _some("keyboard", 0.5, "study,bedroom", FLAT, 0.8),
        _some("remote", 0.2, "living room", SMALL, 0.6),
        _some("handbag", 0.25, "bedroom,storage", SMALL, 0.5),
        _some("suitcase", 0.3, "bedroom,storage", (0.4, 0.25, 0.6), 0.3, (1, 3), 1.5),
        _some("backpack", 0.2, "bedroom,study,storage", SMALL, 0.4),
        _some("teddy bear", 0.25, "bedroom", SMALL, 0.6, (1, 3), 1.0),
        _some("bench", 0.2, f"living room,{CORRIDOR},bedroom", (1.0, 0.4, 0.45), 0.25),
        _some("toothbrush", 0.2, "bathroom", SMALL, 1.0),
        _some("umbrella", 0.2, CORRIDOR, SMALL, 0.4),
        _some("bicycle", 0.15, f"storage,{CORRIDOR}", (1.2, 0.2, 0.9), 0.5),
    ),
    depth_m=(3.4, 5.2),
    corridor_m=(1.2, 2.2),
    wings=(1, 2),
    passages=(0.0, 0.6),
)

COCO_OFFICE = BuildingKind(
    labelspace="coco",
    rooms=(
        _rooms("open plan", (1, 3), (8.0, 14.0), 2.0),
        _rooms("office", (2, 8), (3.2, 4.8)),
        _rooms("meeting room", (1, 3), (4.0, 6.5), 1.2),
        _rooms("lounge", (0, 1), (6.0, 10.0), 2.0),
        _rooms("kitchen", (1, 1), (3.5, 5.0), 1.2),
        _rooms("bathroom", (1, 3), (2.2, 3.4)),
    ),
    things=(
        _some("tv", 7.0, "open plan", (1.4, 0.75, 0.5), 1.0, (4, 8), 6.0),
        _some("tv", 1.5, "office", (1.4, 0.75, 0.5), 1.0, (1, 2)),
        _one("tv", 0.7, "meeting room", (1.2, 0.1, 0.7), 1.5),
        _beside("chair", 0.85, "tv", (0.6, 0.6, 0.95), 0.48),
        _one("dining table", 0.9, "meeting room,kitchen", (1.8, 0.9, 0.75), 0.4, "floor"),
        _around("chair", 5.0, "meeting room", (4, 8), 2.6),
        _around("chair", 2.5, "kitchen,lounge", (2, 5), 2.2),
        _some("keyboard", 1.2, "open plan,office", FLAT, 0.8, (1, 4), 5.0),
        _some("laptop", 0.8, "open plan,office,meeting room", FLAT, 0.8, (1, 3), 4.0),
        _some("mouse", 0.5, "open plan,office", SMALL, 0.8, (1, 3), 4.0),
        _some("couch", 2.0, "lounge", (1.9, 0.9, 0.8), 0.4, (2, 4), 5.0),
        _some(
            "potted plant", 1.0, f"lounge,open plan,{CORRIDOR},office,meeting room", (0.5, 0.5, 1.2), 0.6, (1, 4), 4.0
        ),
        _some("book", 0.8, "office,lounge,open plan", FLAT, 1.1, (1, 6), 1.5),
        _some("bottle", 0.8, "kitchen,office,open plan", SMALL, 0.9, (1, 4), 2.0),
        _some("cup", 0.7, "kitchen,office,open plan,meeting room", SMALL, 0.9, (1, 4), 2.0),
        _some("backpack", 0.5, "office,open plan", SMALL, 0.3),
        _some("clock", 0.25, f"meeting room,open plan,kitchen,{CORRIDOR}", (0.3, 0.1, 0.3), 2.0),
        _some("bench", 0.2, f"lounge,{CORRIDOR}", (1.2, 0.4, 0.45), 0.25),
        _one("refrigerator", 0.9, "kitchen", (0.7, 0.7, 1.7), 0.9),
        _one("microwave", 0.8, "kitchen", (0.5, 0.4, 0.3), 1.2),
        _one("oven", 0.3, "kitchen", (0.6, 0.6, 0.9), 0.5),
        _one("sink", 0.95, "kitchen,bathroom", (0.6, 0.5, 0.3), 0.85),
        _some("toilet", 1.4, "bathroom", (0.7, 0.4, 0.8), 0.4, (1, 2), 2.5),
    ),
    depth_m=(4.0, 6.5),
    corridor_m=(1.6, 3.0),
    wings=(1, 2),
    passages=(0.0, 0.4),
)

OFFICE = BuildingKind(
    labelspace="uhumans2_office",
    rooms=(
        _rooms("open plan", (1, 4), (8.0, 17.0), 2.5),
        _rooms("lounge", (1, 2), (5.0, 14.0), 2.5),
        _rooms("office", (1, 9), (3.4, 4.8)),
        _rooms("kitchen", (1, 2), (4.0, 6.0), 1.2),
    ),
    things=(
        _some("computer", 8.0, "open plan", (1.4, 0.75, 0.45), 0.95, (4, 14), 7.0),
        _some("computer", 1.5, "office", (1.4, 0.75, 0.45), 0.95, (1, 3)),
        _some("couch", 2.5, "lounge", (1.9, 0.9, 0.8), 0.4, (2, 6), 6.0),
        _some("couch", 0.5, "open plan,kitchen,office", (1.9, 0.9, 0.8), 0.4, (1, 3), 5.0),
        _beside("chair", 0.75, "computer", (0.6, 0.6, 0.95), 0.48),
        _around("chair", 1.5, "lounge,kitchen,office", (1, 6), 3.0),
        _some("plant", 1.2, f"lounge,open plan,office,{CORRIDOR}", (0.5, 0.5, 1.2), 0.6, (1, 6), 6.0),
        _some("painting", 0.7, f"{CORRIDOR},lounge,office,open plan", (1.0, 0.05, 0.8), 1.6),
        _some("bench", 0.4, f"{CORRIDOR},lounge", (1.4, 0.4, 0.45), 0.25),
        _beside("trash can", 0.2, "computer", (0.3, 0.3, 0.4), 0.2),
        _one("trash can", 0.7, f"kitchen,lounge,open plan,{CORRIDOR}", (0.3, 0.3, 0.4), 0.2, "door"),
    ),
    depth_m=(4.5, 7.0),
    corridor_m=(1.8, 3.4),
    wings=(1, 2),
    passages=(0.0, 0.4),
    clutter=2.0,
)

KINDS: dict[KindName, BuildingKind] = {"home": HOME, "coco_office": COCO_OFFICE, "office": OFFICE}
"""Kinds of buildings by name."""
