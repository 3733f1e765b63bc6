"""A map on a Milvus server as one who changes it sees it: what is committed, and over it what is not written yet."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping

from semloc_core.encoding import Model
from semloc_core.fleet.milvus.reading import State, read_building, read_model, read_state, state_now
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.writing.conflicts import Draft
from semloc_core.map_database import (
    ClassChange,
    MapMeta,
    PlaceRows,
    StoredBuilding,
    WritableMap,
    content_hash,
    unknown_building,
)

_KEPT = 4  # buildings as they were read


class OpenedMap(WritableMap):
    """What can be read of a map that is open for changes.

    Args:
        server: where it is.

    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._last = read_state(server, self.name)
        self._stale = False
        self._drafts: dict[str, Draft | None] = {}
        self._fresh_model: Model | None = None
        self._depth = 0
        self._read: OrderedDict[int, tuple[StoredBuilding, PlaceRows]] = OrderedDict()
        self._read_model: tuple[int, Model] | None = None

    @property
    def name(self) -> str:
        return self._server.address.name

    @property
    def meta(self) -> MapMeta:
        """As of `WritableMap`, without what is not committed yet; ``generation`` rises with every change."""
        row, pointers = self._state.map_row, self._state.pointers
        digests = ((name, pointer.digest) for name, (_, pointer) in pointers.items())
        return MapMeta(
            model_hash=row.model_hash,
            model_name=row.model_name,
            labelspace_hash=row.labelspace_hash,
            labelspace_name=row.labelspace_name,
            dimension=row.dimension,
            content_hash=content_hash(row.model_hash, row.labelspace_hash, digests),
            generation=self._state.change,
        )

    @property
    def buildings(self) -> tuple[str, ...]:
        names = set(self._state.pointers) if self._fresh_model is None else set()
        for name, draft in self._drafts.items():
            (names.discard if draft is None else names.add)(name)
        return tuple(sorted(names))

    @property
    def digests(self) -> dict[str, str]:
        """Digests of the buildings that are committed."""
        return {name: pointer.digest for name, (_, pointer) in self._state.pointers.items()}

    @property
    def model(self) -> Model:
        """The map's model."""
        if self._fresh_model is not None:
            return self._fresh_model
        generation = self._state.model_generation
        if self._read_model is None or self._read_model[0] != generation:
            self._read_model = generation, read_model(self._server, self.name, self._state)
        return self._read_model[1]

    @property
    def _state(self) -> State:
        """The map as it was when the transaction began, or is after it."""
        if self._stale:
            self._last = state_now(self._server, self.name, self._last)
            self._stale = False
        return self._last

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        if self._drafts.get(building) is None:
            self._check_known(building)
            return self._state.pointers[building][1].changes
        return self.history(building).classes

    @property
    def _dimension(self) -> int:
        return self._state.map_row.dimension if self._fresh_model is None else self._fresh_model.encoder.dimension

    def _check_known(self, name: str) -> None:
        if name not in (names := self.buildings):
            raise unknown_building(name, names)

    def building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
        draft = self._drafts.get(name)
        if draft is not None:
            return draft.stored, draft.places
        self._check_known(name)
        generation, pointer = self._state.pointers[name]
        if generation not in self._read:
            dimension = self._state.map_row.dimension
            self._read[generation] = read_building(self._server, self.name, dimension, generation, pointer)
            while len(self._read) > _KEPT:
                self._read.popitem(last=False)
        self._read.move_to_end(generation)
        return self._read[generation]
