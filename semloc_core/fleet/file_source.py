"""The embedded file, or a map in memory, as a `MapSource`: the same interface without a server."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.fleet.object_votes import MappedObjects, objects_of
from semloc_core.fleet.source import BuildingEntry, Catalogue, Fetched, Nearest
from semloc_core.map_database import ExactSearch, LoadedMap, building_digest, load, read, read_meta, unpack_history

LOOKED_AT = 2**16
"""Places of a map whose similarity ranks its buildings, at most: those beside them tell no more of a building."""


class LoadedSource:
    """A map in memory, queried.

    Args:
        loaded: the map.

    """

    def __init__(self, loaded: LoadedMap) -> None:
        self._map = loaded
        self._catalogue = _catalogue_of(loaded)

    @property
    def name(self) -> str:
        return self._map.name

    def model(self) -> Model:
        return self._map.model

    def catalogue(self) -> Catalogue:
        """What there is; it does not change."""
        return self._catalogue

    def nearest(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Nearest:
        """By `LoadedMap.search`; see `MapSource.nearest`."""
        if z.ndim != 1:
            raise MapError(f"expected one query (got shape {z.shape})")
        rows, similarities = self._map.search(z, k, buildings)
        numbers, names, ids = self._map.building_index[rows].tolist(), self._map.buildings, self._map.place_ids
        return Nearest(tuple(names[i] for i in numbers), tuple(ids[row] for row in rows.tolist()), similarities)

    def similar(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Mapping[str, float]:
        """Of all buildings: at every so manieth place where there are more than `LOOKED_AT`."""
        names, first, search = self._spread
        best = np.maximum.reduceat(search.everywhere(z, 1)[2], first).tolist() if names else []
        return {name: one for name, one in zip(names, best, strict=True) if buildings is None or name in buildings}

    @cached_property
    def _spread(self) -> tuple[tuple[str, ...], NDArray[np.int64], ExactSearch]:
        """Buildings, where each one's places begin in a search of places spread evenly over all, and that search."""
        held = self._map
        step = -(-held.n_places // LOOKED_AT) or 1
        starts = np.searchsorted(held.building_index, np.arange(len(held.buildings)))
        rows = np.flatnonzero((np.arange(held.n_places) - starts[held.building_index]) % step == 0)
        first = np.searchsorted(held.building_index[rows], np.arange(len(held.buildings))).astype(np.int64)
        return held.buildings, first, ExactSearch(np.ascontiguousarray(held.embeddings[rows]))

    def objects(self, buildings: Collection[str]) -> Mapping[str, MappedObjects]:
        """Of all of these: a file has their scene graphs."""
        return {name: objects_of(self._map.graph(name), self._map.model.labelspace) for name in buildings}

    def fetch(self, building: str) -> Fetched:
        stored, places = self._map.building(building)
        return Fetched(self._catalogue.buildings[building], stored, places)

    def close(self) -> None:
        """Nothing is held open."""


class FileSource(LoadedSource):
    """A map file, queried. It is held in memory, and read again when a writer has changed it.

    Args:
        path: the map file.

    Raises:
        MapError: not a map, or damaged.

    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        super().__init__(load(self._path))

    def catalogue(self) -> Catalogue:
        """The file as it is now."""
        if read(self._path, lambda connection: read_meta(connection).content_hash) != self._map.hash:
            self._map = load(self._path)
            self._catalogue = _catalogue_of(self._map)
            self.__dict__.pop("_spread", None)
        return self._catalogue


def _catalogue_of(map_: LoadedMap) -> Catalogue:
    entries = {}
    for stored, places in map(map_.building, [each.name for each in map_.stored]):
        digest = building_digest(places, stored.frame_id, stored.graph.digest, stored.history)
        changes = unpack_history(stored.history).classes
        entries[stored.name] = BuildingEntry(digest, digest, stored.n_places, changes)
    model = map_.model
    return Catalogue(map_.hash, model.hash, model.labelspace.hash, model.encoder.dimension, entries)
