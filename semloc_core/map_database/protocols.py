"""What a map can do, wherever it is kept: for whoever merges into maps and edits them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, Unpack

from numpy.typing import ArrayLike

from semloc_core.encoding import Model
from semloc_core.graph import SceneGraph
from semloc_core.map_database.history import ClassChange, History
from semloc_core.map_database.loaded import StoredBuilding
from semloc_core.map_database.stored.records import Note, PlaceRows


class ReadableMap(Protocol):
    """What is read of a map: a `LoadedMap` has it, and whatever is a `WritableMap`."""

    @property
    def buildings(self) -> tuple[str, ...]:
        """Their names."""

    def graph(self, building: str) -> SceneGraph:
        """The scene graph of one."""

    def history(self, building: str) -> History:
        """The history of one."""

    def changes(self, building: str) -> Mapping[str, ClassChange]:
        """The class changes in the history of one."""

    def require(self, model_hash: str | None = None, labelspace_hash: str | None = None) -> None:
        """Refuse another model or labelspace."""


class WritableMap(ReadableMap, Protocol):
    """A map open for changes: a `MapDatabase`, or a `semloc_core.fleet.writing.database.FleetDatabase`.

    What each method does is said at `MapDatabase`.
    """

    def transaction(self) -> AbstractContextManager[None]:
        """Several changes as one: all or none."""

    def place_ids(self, building: str) -> tuple[str, ...]:
        """A building's places, by rising id."""

    def add_building(
        self,
        name: str,
        graph: SceneGraph,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        **note: Unpack[Note],
    ) -> None:
        """Add a building."""

    def replace_building(
        self,
        name: str,
        graph: SceneGraph,
        place_ids: Sequence[str],
        positions: ArrayLike,
        embeddings: ArrayLike,
        **note: Unpack[Note],
    ) -> None:
        """Put a building in place of the one of that name."""

    def copy_building(self, stored: StoredBuilding, places: PlaceRows) -> None:
        """Put a building as another map holds it in place of the one of that name, or add it."""

    def revise_building(
        self, name: str, graph: SceneGraph, positions: ArrayLike, embeddings: ArrayLike, history: History | None = None
    ) -> None:
        """Put what is known of a building by now in place of what was."""

    def replace_places(
        self, building: str, place_ids: Sequence[str], positions: ArrayLike, embeddings: ArrayLike
    ) -> None:
        """Put places in place of those of the same ids, or add them."""

    def remove_building(self, name: str) -> None:
        """Remove a building."""

    def reset(self, model: Model) -> None:
        """Remove every building and put a model in."""
