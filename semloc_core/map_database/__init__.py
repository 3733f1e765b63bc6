"""The map: one SQLite file that is all a robot needs. `load` to localise, `MapDatabase` to change it."""

from semloc_core.map_database.database import MapDatabase
from semloc_core.map_database.info import describe
from semloc_core.map_database.loaded import LoadedMap, load

__all__ = ["LoadedMap", "MapDatabase", "describe", "load"]
