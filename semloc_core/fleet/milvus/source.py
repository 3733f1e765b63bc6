"""A map on a Milvus server as a `MapSource`: what robots read."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model
from semloc_core.errors import MapError, MapUnavailableError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.nearest import Hits, clean_hits, search_parameters
from semloc_core.fleet.milvus.reading import (
    State,
    current,
    read_building,
    read_change,
    read_model,
    read_objects,
    read_state,
)
from semloc_core.fleet.milvus.rows import MissingRowsError
from semloc_core.fleet.milvus.server import DEFAULT_TIMEOUT_S, MAX_ROWS, Server
from semloc_core.fleet.object_votes import MappedObjects
from semloc_core.fleet.source import Catalogue, Fetched, Nearest
from semloc_core.map_database import content_hash

POLL_S = 1.0
_BUILDINGS_AT_ONCE = 4096  # named in one search
_ROUNDS = 3


class MilvusSource:
    """A map on a server, queried; nothing is asked of the server before the first call. May be used by several threads.

    Args:
        address: which map.
        timeout_s: how long one call to the server may take; a method may make several.
        poll_s: the server is not asked more often than this whether the catalogue has changed.

    """

    def __init__(self, address: MilvusAddress, timeout_s: float = DEFAULT_TIMEOUT_S, poll_s: float = POLL_S) -> None:
        self._server = Server(address, timeout_s)
        self._poll_s = poll_s
        self._lock = threading.RLock()
        self._state: State | None = None
        self._catalogue: Catalogue | None = None
        self._model: tuple[int, Model] | None = None
        self._parameters: tuple[str, str] | None = None
        self._changes: deque[int] = deque(maxlen=64)  # numbers of changes that the state is known to hold
        self._strangers: set[int] = set()  # generations with rows that nothing pointed to when they were found
        self._asked = -np.inf

    @property
    def name(self) -> str:
        return self._server.address.name

    def close(self) -> None:
        self._server.close()

    def model(self) -> Model:
        with self._lock:
            state = self._now()
            if self._model is None or self._model[0] != state.model_generation:
                with self._doubting():
                    try:
                        model = read_model(self._server, self.name, state)
                    except MissingRowsError:  # swept: another model has taken its place
                        state = self._look_again()
                        model = read_model(self._server, self.name, state)
                self._model = state.model_generation, model
            return self._model[1]

    def catalogue(self) -> Catalogue:
        """The map as it was at most ``poll_s`` and a few seconds ago; what was asked in between may be newer."""
        with self._lock:
            state = self._now()
            if self._catalogue is None:
                row = state.map_row
                digests = ((name, pointer.digest) for name, (_, pointer) in state.pointers.items())
                self._catalogue = Catalogue(
                    content_hash(row.model_hash, row.labelspace_hash, digests),
                    row.model_hash,
                    row.labelspace_hash,
                    row.dimension,
                    {name: pointer.entry(generation) for name, (generation, pointer) in state.pointers.items()},
                )
            return self._catalogue

    def fetch(self, building: str) -> Fetched:
        """One building; where it was replaced meanwhile, as it is now."""
        with self._lock:
            for last in (False, False, True):
                generation, pointer = current(self._now, self._look_again, building)
                dimension = self._now().map_row.dimension
                with self._doubting():
                    try:
                        stored, places = read_building(self._server, self.name, dimension, generation, pointer)
                    except MissingRowsError:  # swept since its row in the catalogue was read, it may be
                        if last or self._look_again().pointers.get(building, (generation, pointer))[0] == generation:
                            raise
                        continue
                return Fetched(pointer.entry(generation), stored, places)
            raise AssertionError("the last try returns or raises")

    def similar(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Mapping[str, float]:
        """Of the buildings that the k places most similar lie in."""
        found: dict[str, float] = {}
        near = self.nearest(z, k, buildings)
        for name, similarity in zip(near.buildings, near.similarities.tolist(), strict=True):
            found.setdefault(name, similarity)
        return found

    def objects(self, buildings: Collection[str]) -> Mapping[str, MappedObjects]:
        """As of `MapSource.objects`; of buildings that were written before maps said them nothing."""
        with self._lock:
            n_classes, state = len(self.model().labelspace), self._now()
            of = {current(lambda: state, self._look_again, name)[0]: name for name in buildings}
            with self._doubting():
                found = read_objects(self._server, self.name, sorted(of), n_classes)
            return {of[generation]: its for generation, its in found.items()}

    def nearest(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Nearest:
        """By the server's index: approximate, unless that is ``FLAT``; see `MapSource.nearest`."""
        with self._lock:
            state = self._now()
            dimension = state.map_row.dimension
            if z.shape != (dimension,) or not np.isfinite(z).all():
                raise MapError(f"expected a finite query of {dimension} numbers (got {z.shape} {z.dtype})")
            if not 1 <= k <= MAX_ROWS:
                raise MapError(f"expected k of 1 to {MAX_ROWS} (got {k})")
            if buildings is None:
                return self._everywhere(state, z, k)
            for name in buildings:
                if name not in state.pointers:
                    state = self._look_again()
                    break
            chosen = {current(lambda: state, lambda: state, name)[0] for name in buildings}
            return self._among(state, z, k, sorted(chosen))

    def _everywhere(self, state: State, z: NDArray[np.float32], k: int) -> Nearest:
        """Search without naming all buildings; rows that nothing points to are left out, and made up for."""
        for _ in range(_ROUNDS):
            listed = ", ".join(map(str, sorted(self._strangers)))
            hits = self._search(state, z, k, f"generation not in [{listed}]" if self._strangers else "")
            nearest, unknown = hits.of(state.names, k)
            if not unknown:
                return nearest
            state = self._look_again()  # generations that were written since, or not yet, or are to be swept
            nearest, unknown = hits.of(state.names, k)
            if not unknown:
                return nearest
            self._strangers |= unknown
        if len(state.pointers) > _BUILDINGS_AT_ONCE:
            return nearest  # without what a search by naming them would add: too many to name
        return self._among(state, z, k, sorted(state.names))

    def _among(self, state: State, z: NDArray[np.float32], k: int, chosen: Sequence[int]) -> Nearest:
        """Search in some generations of a state."""
        found = Hits()
        for start in range(0, len(chosen), _BUILDINGS_AT_ONCE):
            listed = ", ".join(map(str, chosen[start : start + _BUILDINGS_AT_ONCE]))
            found = found.joined(self._search(state, z, k, f"generation in [{listed}]"))
        return found.of(state.names, k)[0]

    def _search(self, state: State, z: NDArray[np.float32], k: int, condition: str) -> Hits:
        collection = layout.places(self.name, state.map_row.dimension)
        if self._parameters is None or self._parameters[0] != collection:
            self._parameters = collection, self._server.index_type(collection)
        parameters = search_parameters(self._parameters[1], k)
        rows = self._server.search(collection, z.tolist(), k, condition, ("generation", "id"), parameters)
        return clean_hits(rows)

    def _now(self) -> State:
        """The state at hand, read anew where the server says that it has changed."""
        if self._state is None:
            return self._look_again()
        if time.monotonic() - self._asked < self._poll_s:
            return self._state
        change = read_change(self._server, self.name)
        self._asked = time.monotonic()
        if change != self._state.change and change not in self._changes:  # that is looked up, not believed
            return self._look_again()
        return self._state

    @contextmanager
    def _doubting(self) -> Iterator[None]:
        """Where what is fetched is not what the catalogue says, the catalogue at hand is not believed any longer."""
        try:
            yield
        except MapUnavailableError:
            raise
        except MapError:
            self._state = self._catalogue = None
            raise

    def _look_again(self) -> State:
        state = read_state(self._server, self.name, self._state)
        self._asked = time.monotonic()
        if self._state is None or state.change != self._state.change:
            self._catalogue = None
            self._changes.append(state.change)
            current = state.generations()
            # What is known to be left over is not even searched; the newest, if there is more than can be named.
            self._strangers = set(sorted(self._strangers - current)[-_BUILDINGS_AT_ONCE:])
        self._state = state
        return state
