"""What a map can do, wherever it is kept: what is said of every change, and all of it but reading and writing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Self, TypeAlias, Unpack

import numpy as np
from numpy.typing import ArrayLike

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.graph import SceneGraph
from semloc_core.map_database.history import ClassChange, History, pack_history, unpack_history
from semloc_core.map_database.loaded import LoadedMap, StoredBuilding
from semloc_core.map_database.stored.meta import MapMeta, check_hash
from semloc_core.map_database.stored.records import Note, PlaceRows, check_name, check_places, unpack_graph
from semloc_core.map_database.stored.write import check_in_graph, stored_building


class WritableMap(ABC):
    """A map open for changes, a context manager: a `MapDatabase`, or a `semloc_core.fleet.FleetDatabase`.

    A change that is refused (MapError) leaves the map as it was.
    """

    # -- what each does in its own way ---------------------------------------------------------------------------

    @property
    @abstractmethod
    def name(self) -> str:
        """The map's name, for errors."""

    @property
    @abstractmethod
    def meta(self) -> MapMeta:
        """What the map says of itself: hashes and names of model and labelspace, content hash, generation."""

    @property
    @abstractmethod
    def buildings(self) -> tuple[str, ...]:
        """Names of the buildings, sorted."""

    @abstractmethod
    def building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
        """A building as it is stored; MapError where the map does not have it."""

    @abstractmethod
    def transaction(self) -> AbstractContextManager[None]:
        """Several changes as one: all of them are there at the end, or none if an exception leaves the block."""

    @abstractmethod
    def remove_building(self, name: str) -> None:
        """Remove a building and all its places; MapError where the map does not have it."""

    @abstractmethod
    def reset(self, model: Model) -> None:
        """Remove every building and put a model in, to build anew; meant for inside a `transaction`."""

    @abstractmethod
    def close(self) -> None:
        """Close the map; what was committed stays."""

    @abstractmethod
    def _write(self, stored: StoredBuilding, places: PlaceRows, *, new: bool, revised: bool) -> None:
        """Put a building in place of the one of that name, or add it.

        Args:
            stored: the building.
            places: its places.
            new: there must be none of that name.
            revised: it is made of what was read of the one that is there.

        """

    @property
    def _dimension(self) -> int:
        """D of the embeddings that are to be written."""
        return self.meta.dimension

    # -- what follows ------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def require(self, model_hash: str | None = None, labelspace_hash: str | None = None) -> None:
        """Refuse a map of another model or labelspace; MapError names both sides."""
        meta = self.meta
        check_hash("model", model_hash, meta.model_hash, meta.model_name, self.name)
        check_hash("labelspace", labelspace_hash, meta.labelspace_hash, meta.labelspace_name, self.name)

    def place_ids(self, building: str) -> tuple[str, ...]:
        """A building's places, by rising id."""
        return self.building(building)[1].ids

    def graph(self, building: str) -> SceneGraph:
        """The scene graph of a building."""
        return unpack_graph(self.building(building)[0].graph)

    def history(self, building: str) -> History:
        """What traversals have told of a building since it was mapped."""
        return unpack_history(self.building(building)[0].history)

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        """The class changes in a building's history."""
        return self.history(building).classes

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
            MapError: the name is taken, or something does not fit.

        """
        with self.transaction():
            if name in self.buildings:
                raise MapError(f"expected a building that the map does not have (got {name!r})")
            places = check_places(place_ids, positions, embeddings, self._dimension)
            self._put(stored_building(name, graph, places.ids, note), places, new=True)

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
            MapError: embeddings that do not fit, places that its scene graph lacks.

        """
        with self.transaction():
            fits = check_places(places.ids, places.positions, places.embeddings, self._dimension)
            check_in_graph(unpack_graph(stored.graph), fits.ids)
            self._put(stored, fits)

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
            MapError: an unknown building, numbers that do not fit.

        """
        with self.transaction():
            old, _ = self.building(name)
            places = check_places(sorted(graph.places), positions, embeddings, self._dimension)
            self._revise(old if history is None else replace(old, history=pack_history(history)), places, graph)

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
                numbers that do not fit.

        """
        with self.transaction():
            if not set(place_ids).isdisjoint(self.place_ids(building)):
                raise MapError(f"expected places that {building!r} does not have (got one that it has)")
            self.replace_places(building, place_ids, positions, embeddings, graph=graph)

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
        with self.transaction():
            old, before = self.building(building)
            fresh = check_places(place_ids, positions, embeddings, self._dimension)
            stay = before.only(set(before.ids).difference(fresh.ids))
            ids, where = (*stay.ids, *fresh.ids), np.concatenate([stay.positions, fresh.positions])
            places = check_places(ids, where, np.concatenate([stay.embeddings, fresh.embeddings]), self._dimension)
            if graph is None and (new := set(fresh.ids).difference(before.ids)):
                check_in_graph(unpack_graph(old.graph), sorted(new))
            self._revise(old, places, graph)

    def remove_places(self, building: str, place_ids: Sequence[str], *, graph: SceneGraph | None = None) -> None:
        """Remove some of a building's places, and store the scene graph without them where it is given.

        Raises:
            MapError: an unknown building or place, a place twice, or no place would be left.

        """
        if len(set(place_ids)) != len(place_ids):
            raise MapError("expected each place once (got one twice)")
        with self.transaction():
            old, before = self.building(building)
            if strangers := sorted(set(place_ids).difference(before.ids)):
                what = f"got {strangers[0]!r}, which it does not have"
                raise MapError(f"expected a place of building {building!r} ({what})")
            self._revise(old, before.only(set(before.ids).difference(place_ids)), graph)

    def rebuild(self, model: Model, embeddings: Mapping[str, ArrayLike]) -> None:
        """Put another model in and replace every embedding, in one transaction.

        Args:
            model: the new model.
            embeddings: for each building of the map (P, D) in the order of its place ids (rising).

        Raises:
            MapError: a building is missing or unknown, or numbers do not fit.

        """
        with self.transaction():
            if sorted(embeddings) != list(self.buildings):
                raise MapError(f"expected embeddings of {list(self.buildings)} (got {sorted(embeddings)})")
            old = [self.building(name) for name in self.buildings]
            self.reset(model)
            for stored, places in old:
                z = embeddings[stored.name]
                self._put(stored, check_places(places.ids, places.positions, z, model.encoder.dimension))

    def _revise(self, old: StoredBuilding, places: PlaceRows, graph: SceneGraph | None) -> None:
        stored = replace(old, n_places=len(places.ids), storeys=None)
        if graph is not None:
            note: Note = {"source": old.source, "frame_id": old.frame_id, "stamp_ns": old.stamp_ns}
            stored = stored_building(old.name, graph, places.ids, note, old.history)
        self._put(stored, places, revised=True)

    def _put(self, stored: StoredBuilding, places: PlaceRows, *, new: bool = False, revised: bool = False) -> None:
        check_name("a building name", stored.name)
        if not places.ids:
            raise MapError(f"expected at least one place in building {stored.name!r} (got none)")
        self._write(stored, places, new=new, revised=revised)


ReadableMap: TypeAlias = LoadedMap | WritableMap
"""What can be read: buildings, their graphs and histories."""
