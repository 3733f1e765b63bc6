"""Generated buildings: a floor plan, furniture in groups, places in the free space; written as Hydra files."""

from semloc_core.world.floor_plan import RoomKind
from semloc_core.world.furniture import Furniture
from semloc_core.world.office import (
    OFFICE_FURNITURE,
    OFFICE_ROOMS,
    OfficeConfig,
    World,
    make_office,
    write_world,
)

__all__ = [
    "OFFICE_FURNITURE",
    "OFFICE_ROOMS",
    "Furniture",
    "OfficeConfig",
    "RoomKind",
    "World",
    "make_office",
    "write_world",
]
