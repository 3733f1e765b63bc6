"""A map in memory: all that localisation reads, in one matrix, with no tie to the file it came from."""

from __future__ import annotations

import logging
import sqlite3
from bisect import bisect_left
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import Batch, Model, QueryEncoder
from semloc_core.errors import MapError
from semloc_core.graph import SceneGraph, read_graph, separate, storey_at
from semloc_core.map_database.building_patterns import matching_buildings, unknown_building
from semloc_core.map_database.history import ClassChange, History, unpack_history
from semloc_core.map_database.search.exact import ExactSearch
from semloc_core.map_database.search.inverted import LARGE, InvertedSearch
from semloc_core.map_database.stored.meta import check_hash, read_meta, read_model
from semloc_core.map_database.stored.records import (
    PackedGraph,
    PlaceRows,
    building_digest,
    building_names,
    content_hash,
    derived_storeys,
    read_history_bytes,
    read_places,
    read_storeys,
    unpack_graph,
)
from semloc_core.map_database.stored.schema import read
from semloc_core.map_database.weights import class_weights
from semloc_core.text import short_repr
from semloc_core.wire import Position

logger = logging.getLogger(__name__)


@short_repr
@dataclass(frozen=True)
class StoredBuilding:
    """One building: its source, frame, when it was made (ns, or None), packed scene graph and history.

    ``storeys`` are those of its places, by rising id; None where they are to be derived from the scene graph.
    """

    name: str
    source: str
    frame_id: str
    stamp_ns: int | None
    n_places: int
    graph: PackedGraph
    history: bytes = b""
    storeys: tuple[int, ...] | None = None


@short_repr
@dataclass(frozen=True)
class Whole:
    """The map that a part was taken from: what is published of it, and what its classes weigh.

    Args:
        hash: as of `LoadedMap.hash`.
        n_places: of all its buildings.
        changes: class changes of all its buildings that know any.
        buildings: names of all its buildings.

    """

    hash: str
    n_places: int
    changes: tuple[Mapping[str, ClassChange], ...] = ()
    buildings: tuple[str, ...] = ()


@short_repr
@dataclass(frozen=True, eq=False)
class LoadedMap:
    """All places of all buildings, buildings by name and places by id within each.

    Args:
        name: the file's stem.
        hash: sha256 (hex) of the content: model, labelspace, names, ids, positions, embeddings, scene graphs,
            histories.
        model: what made the embeddings.
        buildings: their names.
        place_ids: M ids, unique within a building.
        positions: (M, 3) float64, metres, each in its building's frame.
        building_index: (M,) int32 into ``buildings``.
        embeddings: (M, D) float32, C-contiguous.
        stored: what the file holds of each building besides places; empty for a map that no file holds.
        part_of: the map that these are some buildings of; None for a whole one.

    """

    name: str
    hash: str
    model: Model
    buildings: tuple[str, ...]
    place_ids: tuple[str, ...]
    positions: NDArray[np.float64]
    building_index: NDArray[np.int32]
    embeddings: NDArray[np.float32]
    stored: tuple[StoredBuilding, ...] = ()
    part_of: Whole | None = None

    def __post_init__(self) -> None:
        rows = len(self.place_ids)
        assert self.positions.shape == (rows, 3), self.positions.shape
        assert self.building_index.shape == (rows,), self.building_index.shape
        assert self.building_index.dtype == np.int32, self.building_index.dtype
        assert self.embeddings.shape[0] == rows, self.embeddings.shape
        assert self.embeddings.dtype == np.float32, self.embeddings.dtype
        assert self.embeddings.flags.c_contiguous

    @property
    def n_places(self) -> int:
        """M."""
        return len(self.place_ids)

    @cached_property
    def storeys(self) -> NDArray[np.int64]:
        """(M,) the storey of each place in its building, 0 for the lowest; all 0 in a map that no file holds."""
        found = np.zeros(self.n_places, dtype=np.int64)
        for stored in self.stored:
            rows = self.rows_of(stored.name)
            found[rows] = (
                derived_storeys(stored.graph, self.place_ids[rows]) if stored.storeys is None else stored.storeys
            )
        return found

    @cached_property
    def storey_index(self) -> NDArray[np.int32]:
        """(M,) the number of each place's storey, counted through all buildings: places of one are on one floor."""
        return separate(self.building_index, self.storeys)

    def same_storey(self, building: str, place_id: str, position: Position) -> bool:
        """Whether a place of a building is on the storey that a point (m) of that building is on."""
        return bool(self.storeys[self.row(building, place_id)] == self._storey_of(building, position))

    def chance(self, building: str, position: Position) -> float:
        """The share of all places that are right where the robot is at a point (m) of a building: a blind guess's."""
        rows = self.rows_of(building)
        away = np.linalg.norm(self.positions[rows] - np.array(position, dtype=np.float64), axis=1)
        right = (away <= MATCH_RADIUS_M) & (self.storeys[rows] == self._storey_of(building, position))
        whole = self.part_of.n_places if self.part_of is not None else self.n_places
        return float(right.sum() / whole)

    def _storey_of(self, building: str, position: Position) -> int:
        """The storey that a point of a building is on."""
        rows = self.rows_of(building)
        storeys = self.storeys[rows]
        return storey_at(np.array(position, dtype=np.float64), self.positions[rows], storeys) if storeys.any() else 0

    @cached_property
    def index(self) -> ExactSearch:
        """Search over the embeddings."""
        return ExactSearch(self.embeddings)

    @cached_property
    def quick(self) -> ExactSearch | InvertedSearch:
        """Search for the nearest alone: exact up to a million places, beyond them approximate where faiss is there."""
        if self.n_places <= LARGE:
            return self.index
        try:
            return InvertedSearch(self.embeddings)
        except MapError as error:
            logger.warning("%s: %d places are searched exactly: %s", self.name, self.n_places, error)
            return self.index

    @cached_property
    def queries(self) -> QueryEncoder:
        """The model's encoder, made ready for one place at a time; a map's model is not trained on."""
        return QueryEncoder(self.model.encoder)

    def search(
        self, z: ArrayLike, k: int, buildings: Collection[str] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The k most similar places: rows and similarities by falling similarity, ties by rising row (see `quick`).

        Args:
            z: (D,) one query, or (B, D) several.
            k: how many at most.
            buildings: search these only.

        Returns:
            Rows (K,) or (B, K) and similarities of the same shape.

        Raises:
            MapError: a query that does not fit the map, or an unknown building.

        """
        if buildings is None:
            return self.quick.search(z, k)
        mask = np.zeros(self.n_places, dtype=np.bool_)
        for building in buildings:
            mask[self.rows_of(building)] = True
        return self.quick.search(z, k, mask)

    def rows_of(self, building: str) -> slice:
        """The rows of a building's places."""
        number = self._number(building)
        start, stop = np.searchsorted(self.building_index, [number, number + 1])
        return slice(int(start), int(stop))

    def row(self, building: str, place_id: str) -> int:
        """The row of one place; MapError where the map does not have it."""
        rows = self.rows_of(building)
        found = bisect_left(self.place_ids, place_id, rows.start, rows.stop)
        if found == rows.stop or self.place_ids[found] != place_id:
            raise MapError(f"expected a place of building {building!r} (got {place_id!r}, which it does not have)")
        return found

    def graph(self, building: str) -> SceneGraph:
        """The scene graph that a building's places come from: unpacked at each call, its classes by the map's names."""
        return read_graph(unpack_graph(self.building(building)[0].graph), self.model.labelspace)

    def history(self, building: str) -> History:
        """What traversals have told of a building since it was mapped; empty for a map that no file holds."""
        number = self._number(building)
        return unpack_history(self.stored[number].history) if number < len(self.stored) else History()

    @property
    def all_buildings(self) -> tuple[str, ...]:
        """Names of all buildings of the whole map, where this is a part of one."""
        return self.part_of.buildings if self.part_of is not None else self.buildings

    def narrowed(self, patterns: Sequence[str]) -> LoadedMap:
        """The buildings that patterns such as ``hq/*`` fit, as a part of this map; the map itself where that is all.

        Raises:
            MapError: a pattern that fits no building, or a map that no file holds.

        """
        names = matching_buildings(self.buildings, patterns)
        if names == self.buildings:
            return self
        changes = tuple(filter(None, self._changes()))
        whole = self.part_of or Whole(self.hash, self.n_places, changes, self.buildings)
        return assemble(self.name, self.model, [self.building(each) for each in names], part_of=whole)

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        """The class changes in a building's history."""
        return self.history(building).classes

    def _changes(self) -> Sequence[Mapping[str, ClassChange]]:
        if self.part_of is not None:
            return self.part_of.changes
        return [unpack_history(building.history).classes for building in self.stored]

    @cached_property
    def class_weights(self) -> dict[str, float]:
        """What each class weighs in the whole map (`semloc_core.map_database.weights.class_weights`)."""
        return class_weights(self._changes(), self.model.labelspace)

    @cached_property
    def _class_weights(self) -> torch.Tensor | None:
        """(C,) or None where all weigh 1."""
        if not self.model.encoder.counts_objects:
            return None
        weights = list(self.class_weights.values())
        return None if all(weight == 1.0 for weight in weights) else torch.tensor(weights, dtype=torch.float32)

    def weigh(self, batch: Batch) -> Batch:
        """A query's batch with its objects weighed by class, as the map's are; see `semloc_core.map_database.weights`.

        The batch itself for a map into which no traversal was merged.
        """
        weights = self._class_weights
        return batch if weights is None else batch.with_features(batch.features * weights)

    def frame_id(self, building: str) -> str:
        """The frame of a building's positions; empty where no file says it."""
        number = self._number(building)
        return self.stored[number].frame_id if number < len(self.stored) else ""

    def require(self, model_hash: str | None = None, labelspace_hash: str | None = None) -> None:
        """Refuse a map of another model or labelspace than the caller has.

        Raises:
            MapError: names both sides.

        """
        labelspace = self.model.labelspace
        check_hash("model", model_hash, self.model.hash, self.model.encoder.name, self.name)
        check_hash("labelspace", labelspace_hash, labelspace.hash, labelspace.name, self.name)

    def building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
        """A building as it is stored; MapError where the map does not have it, or where no file holds the map."""
        number = self._number(name)
        if number >= len(self.stored):
            raise MapError(f"expected a map loaded from a file (got {self.name!r}, which holds no scene graphs)")
        rows = self.rows_of(name)
        return self.stored[number], PlaceRows(self.place_ids[rows], self.positions[rows], self.embeddings[rows])

    def _number(self, building: str) -> int:
        found = bisect_left(self.buildings, building)
        if found == len(self.buildings) or self.buildings[found] != building:
            raise unknown_building(building, self.buildings)
        return found


def load(path: str | Path) -> LoadedMap:
    """Open a map file, read one committed state of it, and close it.

    Raises:
        MapError: not a map, damaged, or of another format.

    """
    path = Path(path)
    return read(path, lambda connection: read_map(connection, path.stem))


def read_stored(
    connection: sqlite3.Connection, name: str, dimension: int
) -> tuple[int, StoredBuilding, PlaceRows, str | None]:
    """A building's key, the building but for its storeys, its places, and its digest; None where it has changed."""
    row = connection.execute(
        "SELECT id, source, frame_id, stamp_ns, digest, graph_digest, graph_bytes, graph FROM building WHERE name = ?",
        (name,),
    ).fetchone()
    if row is None:
        raise unknown_building(name, building_names(connection))
    key, source, frame_id, stamp_ns, digest, graph_digest, graph_bytes, data = row
    texts = (source, frame_id, digest or "", graph_digest)
    if not all(isinstance(text, str) for text in texts) or not isinstance(stamp_ns, int | None):
        raise MapError(f"expected texts and a stamp for building {name!r} (got others: the map is damaged)")
    if not isinstance(data, bytes) or not isinstance(graph_bytes, int):
        raise MapError(f"expected a scene graph of building {name!r} (got none: the map is damaged)")
    places, packed = read_places(connection, key, dimension), PackedGraph(graph_digest, graph_bytes, data)
    history = read_history_bytes(connection, key)
    return key, StoredBuilding(name, source, frame_id, stamp_ns, len(places.ids), packed, history), places, digest


def read_building(connection: sqlite3.Connection, name: str, dimension: int) -> tuple[StoredBuilding, PlaceRows, str]:
    """Read one building, its places and its digest, and check that they are what was committed."""
    key, stored, places, digest = read_stored(connection, name, dimension)
    found = building_digest(places, stored.frame_id, stored.graph.digest, stored.history)
    if not places.ids or found != digest:
        raise MapError(f"expected building {name!r} as it was committed (got other content: the map is damaged)")
    on = read_storeys(connection, key, stored.graph.digest, places.ids)
    return replace(stored, storeys=on), places, found


def read_map(connection: sqlite3.Connection, name: str) -> LoadedMap:
    """Read a whole map inside the caller's transaction."""
    meta = read_meta(connection)
    model = read_model(connection, meta)
    names = building_names(connection)
    read_in = [read_building(connection, each, meta.dimension) for each in names]
    found = content_hash(meta.model_hash, meta.labelspace_hash, ((b.name, digest) for b, _, digest in read_in))
    if found != meta.content_hash:
        raise MapError(f"expected content {meta.content_hash[:12]} (got {found[:12]}: the map is damaged)")
    return assemble(name, model, [(building, places) for building, places, _ in read_in], found)


def assemble(
    name: str,
    model: Model,
    buildings: Sequence[tuple[StoredBuilding, PlaceRows]],
    content: str | None = None,
    part_of: Whole | None = None,
) -> LoadedMap:
    """Make one map of buildings that were read.

    Args:
        name: of the map.
        model: what made the embeddings.
        buildings: by rising name.
        content: the map's content hash, where it is known.
        part_of: the map that these are some buildings of.

    """
    if content is None:
        digests = [(b.name, building_digest(p, b.frame_id, b.graph.digest, b.history)) for b, p in buildings]
        content = content_hash(model.hash, model.labelspace.hash, digests)
    all_places = [places for _, places in buildings]
    counts = [len(places.ids) for places in all_places]
    none = np.zeros((0, model.encoder.dimension), dtype=np.float32)
    return LoadedMap(
        name=name,
        hash=content,
        model=model,
        buildings=tuple(building.name for building, _ in buildings),
        place_ids=tuple(id_ for places in all_places for id_ in places.ids),
        positions=np.concatenate([np.zeros((0, 3)), *(places.positions for places in all_places)]),
        building_index=np.repeat(np.arange(len(buildings), dtype=np.int32), counts),
        embeddings=np.concatenate([none, *(places.embeddings for places in all_places)]),
        stored=tuple(building for building, _ in buildings),
        part_of=part_of,
    )
