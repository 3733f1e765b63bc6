"""What a localiser needs of a map that is too large, or too much shared, to be loaded whole: `MapSource`.

The map is narrowed down by its objects (`MapSource.objects`, read once) and by what the server finds similar
(`MapSource.similar`); the robot fetches the few buildings that matter (`MapSource.fetch`) and does the rest by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model
from semloc_core.fleet.object_votes import MappedObjects
from semloc_core.map_database import ClassChange, PlaceRows, StoredBuilding
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True)
class BuildingEntry:
    """One building in the catalogue.

    Args:
        generation: names what was committed: another one whenever the building was written anew.
        digest: sha256 (hex) of its content, equal wherever the same building is stored.
        n_places: how many places it has.
        changes: how its classes changed over the traversals merged into it; what a class weighs in a query follows
            from those of all buildings of the map (`semloc_core.map_database.weights.class_weights`).

    """

    generation: str
    digest: str
    n_places: int
    changes: Mapping[str, ClassChange] = field(default_factory=dict)


@short_repr
@dataclass(frozen=True)
class Catalogue:
    """One consistent state of a map, without its places.

    Args:
        content_hash: as of `LoadedMap.hash`: equal for a file with the same buildings.
        model_hash: of the model that made the embeddings.
        labelspace_hash: of its labelspace.
        dimension: D, numbers an embedding.
        buildings: by name, names rising.

    """

    content_hash: str
    model_hash: str
    labelspace_hash: str
    dimension: int
    buildings: Mapping[str, BuildingEntry]

    @property
    def n_places(self) -> int:
        """Places of all buildings."""
        return sum(entry.n_places for entry in self.buildings.values())


@short_repr
@dataclass(frozen=True, eq=False)
class Nearest:
    """The places most similar to a query, by falling similarity.

    Args:
        buildings: K names of buildings.
        place_ids: K places of them.
        similarities: (K,) float32, inner products.

    """

    buildings: tuple[str, ...]
    place_ids: tuple[str, ...]
    similarities: NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class Fetched:
    """One building as it was committed; its content is checked against ``entry.digest``."""

    entry: BuildingEntry
    stored: StoredBuilding
    places: PlaceRows


class MapSource(Protocol):
    """A map that is queried rather than loaded. What it answers has been checked as a map file is.

    Every method raises `MapUnavailableError` where the map can't be reached within the source's timeout; the next
    call tries again. It raises `MapError` where what came is damaged, or is another map than it was.
    """

    @property
    def name(self) -> str:
        """The map's name."""

    def model(self) -> Model:
        """The model that made the embeddings, checked against its hashes."""

    def catalogue(self) -> Catalogue:
        """The map as it is now: cheap where nothing has changed since the last call (then the same object)."""

    def nearest(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Nearest:
        """The places most similar to a query, of the generations that are in the catalogue.

        Args:
            z: (D,) the query.
            k: how many at most; fewer come back where there are fewer.
            buildings: only places of these; None: of all.

        Raises:
            MapError: a query that does not fit, an unknown building.

        """

    def similar(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None = None) -> Mapping[str, float]:
        """How similar the most similar place of each building is, of those that can be said.

        Args:
            z: (D,) the query.
            k: of how many places, the most similar, where not all are looked at.
            buildings: of these only; None: of all.

        Raises:
            MapError: as of `nearest`.

        """

    def objects(self, buildings: Collection[str]) -> Mapping[str, MappedObjects]:
        """The objects of some buildings; those that the map does not say them of are left out.

        Raises:
            MapError: an unknown building.

        """

    def fetch(self, building: str) -> Fetched:
        """One building, whole, of the generation that is current; MapError for one that the map does not have."""

    def close(self) -> None:
        """Let go of the map; it is not asked again."""
