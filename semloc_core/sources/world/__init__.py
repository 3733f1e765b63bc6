"""Generated buildings: a floor plan, furniture in groups, places in the free space; written as Hydra files."""

from semloc_core.sources.world.floor_plan import RoomKind
from semloc_core.sources.world.furnishings import KINDS, KindName
from semloc_core.sources.world.furniture import Furniture
from semloc_core.sources.world.kinds import BuildingKind, draw_pair
from semloc_core.sources.world.office import (
    OFFICE_FURNITURE,
    OFFICE_ROOMS,
    OfficeConfig,
    World,
    make_office,
    make_world_pair,
    write_world,
)
from semloc_core.sources.world.second_run import SecondRun
from semloc_core.sources.world.stacked import draw_stacked, stack

__all__ = [
    "KINDS",
    "OFFICE_FURNITURE",
    "OFFICE_ROOMS",
    "BuildingKind",
    "Furniture",
    "KindName",
    "OfficeConfig",
    "RoomKind",
    "SecondRun",
    "World",
    "draw_pair",
    "draw_stacked",
    "make_office",
    "make_world_pair",
    "stack",
    "write_world",
]
