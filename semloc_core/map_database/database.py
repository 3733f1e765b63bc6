"""The map database: one SQLite file with places, embeddings, scene graphs and the model that made the embeddings.

Several buildings live in one file, each in its own frame. Every change is a transaction: it is there whole or not
at all, also after a kill or on a full disk. A map is bound to its model and labelspace by content hashes. How the
file is opened, locked and left behind: `semloc_core.map_database.stored.schema`. What localisation reads: `LoadedMap`.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.map_database.history import History, unpack_history
from semloc_core.map_database.loaded import StoredBuilding, read_stored
from semloc_core.map_database.protocols import WritableMap
from semloc_core.map_database.stored.meta import MapMeta, read_meta, seal, write_model
from semloc_core.map_database.stored.records import PlaceRows, building_key, building_names, read_history_bytes
from semloc_core.map_database.stored.schema import close_writer, connect_to_write, create_file, map_errors
from semloc_core.map_database.stored.write import delete_building, insert_building

logger = logging.getLogger(__name__)


class MapDatabase(WritableMap):
    """A map file open for changes; what each can be is said at `WritableMap`. To localise, `load` is enough."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
        self._depth = 0

    @classmethod
    def create(cls, path: str | Path, model: Model, *, exist_ok: bool = False) -> MapDatabase:
        """Make a map without buildings, and open it.

        Args:
            path: the file to make; a process killed meanwhile leaves nothing under this name.
            model: what makes the embeddings.
            exist_ok: open a map that is there already, if it is of the same model.

        Raises:
            MapError: something else is there, or it can't be written.

        """
        path = Path(path)
        if exist_ok and path.exists():
            database = cls.open(path)
            try:
                database.require(model.hash, model.labelspace.hash)
            except BaseException:
                database.close()
                raise
            return database
        create_file(path, lambda connection: write_model(connection, model, generation=0))
        return cls.open(path)

    @classmethod
    def open(cls, path: str | Path) -> MapDatabase:
        """Open a map to change it; an older format is migrated.

        Raises:
            MapError: not a map, damaged, of a newer format, or not to be written.

        """
        return cls(Path(path), connect_to_write(Path(path)))

    def close(self) -> None:
        """Close; the last process to do so leaves one file."""
        close_writer(self._connection)

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def meta(self) -> MapMeta:
        with map_errors(self.path):
            return read_meta(self._connection)

    @property
    def buildings(self) -> tuple[str, ...]:
        with map_errors(self.path):
            return building_names(self._connection)

    def building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
        with map_errors(self.path):
            return read_stored(self._connection, name, self.meta.dimension)[1:3]

    def history(self, building: str) -> History:
        with map_errors(self.path):
            return unpack_history(read_history_bytes(self._connection, building_key(self._connection, building)))

    @contextmanager
    def transaction(self) -> Iterator[None]:
        connection, outermost = self._connection, self._depth == 0
        if not outermost and not connection.in_transaction:
            raise MapError(f"expected a running transaction (got one that failed before: {self.path})")
        with map_errors(self.path):
            connection.execute("BEGIN IMMEDIATE" if outermost else "SAVEPOINT step")
        self._depth += 1
        try:
            yield
            with map_errors(self.path):
                if outermost:
                    seal(connection)
                connection.execute("COMMIT" if outermost else "RELEASE step")
        except BaseException:
            if connection.in_transaction:  # a full disk rolls back by itself
                for command in ("ROLLBACK",) if outermost else ("ROLLBACK TO step", "RELEASE step"):
                    connection.execute(command)
            raise
        finally:
            self._depth -= 1

    @contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        with self.transaction(), map_errors(self.path):
            yield self._connection

    def remove_building(self, name: str) -> None:
        with self._change() as connection:
            delete_building(connection, building_key(connection, name))

    def reset(self, model: Model) -> None:
        with self._change() as connection:
            for name in self.buildings:
                delete_building(connection, building_key(connection, name))
            write_model(connection, model, self.meta.generation)

    def _write(self, stored: StoredBuilding, places: PlaceRows, *, new: bool, revised: bool) -> None:
        with self._change() as connection:
            if stored.name in self.buildings:
                delete_building(connection, building_key(connection, stored.name))
            insert_building(connection, stored, places)
        if new:
            logger.info("%s: building %s added, %d places", self.path, stored.name, len(places.ids))
