"""A map on a Milvus server as one who changes it sees it: what is committed, and over it what is not written yet."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.fleet.milvus.reading import State, read_building, read_model, read_state, state_now
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.writing.conflicts import Draft
from semloc_core.graph import SceneGraph
from semloc_core.map_database import (
    ClassChange,
    History,
    MapMeta,
    PlaceRows,
    StoredBuilding,
    check_hash,
    content_hash,
    unpack_graph,
    unpack_history,
)

_KEPT = 4  # buildings as they were read


class OpenedMap:
    """What can be read of a map that is open for changes; a `ReadableMap`.

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
        """The map's name in its address."""
        return self._server.address.name

    @property
    def meta(self) -> MapMeta:
        """What the map says of itself, without what is not committed yet; ``generation`` rises with every change."""
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
        """Names of the buildings, sorted."""
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

    def require(self, model_hash: str | None = None, labelspace_hash: str | None = None) -> None:
        """Refuse a map of another model or labelspace; MapError names both sides."""
        row = self._state.map_row
        check_hash("model", model_hash, row.model_hash, row.model_name, self.name)
        check_hash("labelspace", labelspace_hash, row.labelspace_hash, row.labelspace_name, self.name)

    @property
    def _state(self) -> State:
        """The map as it was when the transaction began, or is after it."""
        if self._stale:
            self._last = state_now(self._server, self.name, self._last)
            self._stale = False
        return self._last

    def building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
        """A building as it is stored."""
        return self._building(name)

    def place_ids(self, building: str) -> tuple[str, ...]:
        """A building's places, by rising id."""
        return self._building(building)[1].ids

    def graph(self, building: str) -> SceneGraph:
        """The scene graph of a building."""
        return unpack_graph(self._building(building)[0].graph)

    def history(self, building: str) -> History:
        """What traversals have told of a building since it was mapped."""
        return unpack_history(self._building(building)[0].history)

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        """How the classes of a building changed, from the catalogue."""
        if self._drafts.get(building) is None:
            self._check_known(building)
            return self._state.pointers[building][1].changes
        return self.history(building).classes

    @property
    def _dimension(self) -> int:
        return self._state.map_row.dimension if self._fresh_model is None else self._fresh_model.encoder.dimension

    def _check_known(self, name: str) -> None:
        if name not in (names := self.buildings):
            known = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
            raise MapError(f"expected one of the map's buildings: {known or 'none'} (got {name!r})")

    def _building(self, name: str) -> tuple[StoredBuilding, PlaceRows]:
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
