"""The map database: one SQLite file with places, embeddings, scene graphs and the model that made the embeddings.

Several buildings live in one file, each in its own frame. Every change is a transaction: it is there whole or not
at all, also after a kill or on a full disk. A map is bound to its model and labelspace by content hashes. How the
file is opened, locked and left behind: `semloc_core.map_database.stored.schema`. What localisation reads: `LoadedMap`.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Unpack

from numpy.typing import ArrayLike

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.graph import SceneGraph
from semloc_core.map_database.history import ClassChange, History
from semloc_core.map_database.loaded import StoredBuilding
from semloc_core.map_database.stored import write
from semloc_core.map_database.stored.meta import MapMeta, check_hash, read_meta, seal, write_model
from semloc_core.map_database.stored.records import (
    Note,
    PlaceRows,
    building_key,
    building_names,
    check_name,
    check_places,
    read_graph,
    read_history,
    read_places,
    unpack_graph,
)
from semloc_core.map_database.stored.schema import close_writer, connect_to_write, create_file, map_errors

logger = logging.getLogger(__name__)


class MapDatabase:
    """A map file open for changes; use it as a context manager. To localise, `load` is enough."""

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

    def __enter__(self) -> MapDatabase:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def meta(self) -> MapMeta:
        """What the map says of itself: hashes and names of model and labelspace, content hash, generation."""
        with map_errors(self.path):
            return read_meta(self._connection)

    @property
    def buildings(self) -> tuple[str, ...]:
        """Names of the buildings, sorted."""
        with map_errors(self.path):
            return building_names(self._connection)

    def require(self, model_hash: str | None = None, labelspace_hash: str | None = None) -> None:
        """Refuse a map of another model or labelspace; MapError names both sides."""
        meta = self.meta
        check_hash("model", model_hash, meta.model_hash, meta.model_name, self.path.stem)
        check_hash("labelspace", labelspace_hash, meta.labelspace_hash, meta.labelspace_name, self.path.stem)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Several changes as one: all of them are committed at the end, or none if an exception leaves the block."""
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

    def add_building(
        self,
        name: str,
        graph: SceneGraph,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        **note: Unpack[Note],
    ) -> None:
        """Add a building.

        Args:
            name: unique in the map.
            graph: the scene graph that the places belong to; kept for explanations and merges.
            place_ids: P places of it, at least one.
            positions: (P, 3) metres, in the building's frame.
            embeddings: (P, D).
            **note: see `Note`.

        Raises:
            MapError: the name is taken, or something does not fit; the map is as it was.

        """
        check_name("a building name", name)
        with self._change() as connection:
            places = check_places(place_ids, positions, embeddings, self.meta.dimension)
            if name in self.buildings:
                raise MapError(f"expected a building that the map does not have (got {name!r})")
            write.insert_building(connection, write.stored_building(name, graph, places.ids, note), places)
        logger.info("%s: building %s added, %d places", self.path, name, len(places.ids))

    def remove_building(self, name: str) -> None:
        """Remove a building and all its places; MapError where the map does not have it."""
        with self._change() as connection:
            write.delete_building(connection, building_key(connection, name))

    def replace_building(
        self,
        name: str,
        graph: SceneGraph,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        **note: Unpack[Note],
    ) -> None:
        """Put a building in place of the one of that name; arguments and errors as for `add_building`."""
        with self.transaction():
            self.remove_building(name)
            self.add_building(name, graph, place_ids, positions, embeddings, **note)

    def copy_building(self, stored: StoredBuilding, places: PlaceRows) -> None:
        """Put a building as another map holds it in place of the one of that name, or add it.

        Raises:
            MapError: embeddings that do not fit, places that its scene graph lacks. The map is as it was.

        """
        check_name("a building name", stored.name)
        with self._change() as connection:
            fits = check_places(places.ids, places.positions, places.embeddings, self.meta.dimension)
            write.check_in_graph(unpack_graph(stored.graph), fits.ids)
            if stored.name in self.buildings:
                self.remove_building(stored.name)
            write.insert_building(connection, stored, fits)

    def revise_building(
        self, name: str, graph: SceneGraph, positions: ArrayLike, embeddings: ArrayLike, history: History | None = None
    ) -> None:
        """Put what is known of a building by now in place of what was; its source, frame and stamp stay.

        Args:
            name: a building of the map.
            graph: its scene graph; all its places, by rising id, are the building's.
            positions: (P, 3) metres, in the building's frame.
            embeddings: (P, D).
            history: None leaves the one stored.

        Raises:
            MapError: an unknown building, numbers that do not fit. The map is as it was.

        """
        with self._change() as connection:
            key = building_key(connection, name)
            places = check_places(sorted(graph.places), positions, embeddings, self.meta.dimension)
            connection.execute("DELETE FROM place WHERE building = ?", (key,))
            connection.executemany(write.INSERT_PLACE, places.rows(key))
            write.store_graph(connection, key, graph)
            if history is not None:
                write.store_history(connection, key, history)

    def add_places(
        self,
        building: str,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        *,
        graph: SceneGraph | None = None,
    ) -> None:
        """Add places to a building.

        Args:
            building: a building of the map.
            place_ids: P new places.
            positions: (P, 3) metres, in the building's frame.
            embeddings: (P, D).
            graph: the building's scene graph from now on, where the one stored does not have the places.

        Raises:
            MapError: a place that is there already, or that the scene graph lacks; an unknown building;
                numbers that do not fit. The map is as it was.

        """
        self._put_places(building, place_ids, positions, embeddings, graph, replace=False)

    def replace_places(
        self,
        building: str,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        *,
        graph: SceneGraph | None = None,
    ) -> None:
        """Like `add_places`, but places that are there already get the new position and embedding."""
        self._put_places(building, place_ids, positions, embeddings, graph, replace=True)

    def remove_places(self, building: str, place_ids: Sequence[str], *, graph: SceneGraph | None = None) -> None:
        """Remove some of a building's places, and store the scene graph without them where it is given.

        Raises:
            MapError: an unknown building or place, a place twice, or no place would be left.

        """
        if len(set(place_ids)) != len(place_ids):
            raise MapError("expected each place once (got one twice)")
        with self._change() as connection:
            key = building_key(connection, building)
            for id_ in place_ids:
                deleted = connection.execute("DELETE FROM place WHERE building = ? AND id = ?", (key, id_))
                if deleted.rowcount != 1:
                    raise MapError(f"expected a place of building {building!r} (got {id_!r}, which it does not have)")
            write.touch(connection, key, self.meta.dimension, graph)

    def rebuild(self, model: Model, embeddings: Mapping[str, ArrayLike]) -> None:
        """Put another model in and replace every embedding, in one transaction.

        Args:
            model: the new model.
            embeddings: for each building of the map (P, D) in the order of its place ids (rising).

        Raises:
            MapError: a building is missing or unknown, or numbers do not fit. The map is as it was.

        """
        with self._change() as connection:
            if sorted(embeddings) != list(self.buildings):
                raise MapError(f"expected embeddings of {list(self.buildings)} (got {sorted(embeddings)})")
            old = [(name, self._places(name)) for name in self.buildings]
            write_model(connection, model, self.meta.generation)
            for name, places in old:
                key = building_key(connection, name)
                fresh = check_places(places.ids, places.positions, embeddings[name], model.encoder.dimension)
                connection.execute("DELETE FROM place WHERE building = ?", (key,))
                connection.executemany(write.INSERT_PLACE, fresh.rows(key))
                write.touch(connection, key, model.encoder.dimension)

    def reset(self, model: Model) -> None:
        """Remove every building and put a model in, to build anew; meant for inside a `transaction`."""
        with self._change() as connection:
            for name in self.buildings:
                write.delete_building(connection, building_key(connection, name))
            write_model(connection, model, self.meta.generation)

    def place_ids(self, building: str) -> tuple[str, ...]:
        """A building's places, by rising id."""
        with map_errors(self.path):
            return self._places(building).ids

    def graph(self, building: str) -> SceneGraph:
        """The scene graph of a building."""
        with map_errors(self.path):
            return read_graph(self._connection, building_key(self._connection, building))

    def history(self, building: str) -> History:
        """What traversals have told of a building since it was mapped."""
        with map_errors(self.path):
            return read_history(self._connection, building_key(self._connection, building))

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        """The class changes in a building's history."""
        return self.history(building).classes

    def _put_places(
        self,
        building: str,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        graph: SceneGraph | None,
        replace: bool,
    ) -> None:
        with self._change() as connection:
            places = check_places(place_ids, positions, embeddings, self.meta.dimension)
            write.put_places(connection, building, places, graph, replace)

    def _places(self, building: str) -> PlaceRows:
        return read_places(self._connection, building_key(self._connection, building), self.meta.dimension)
