"""A file of more places than one answer can look at: narrowed to a few buildings, as a map on a server is."""

from __future__ import annotations

import numpy as np

from semloc_core.config import LocaliserConfig
from semloc_core.fleet.file_source import LoadedSource
from semloc_core.fleet.link import Link
from semloc_core.fleet.localiser import FleetLocaliser
from semloc_core.fleet.narrowing import ShortlistConfig
from semloc_core.map_database import LoadedMap
from semloc_core.matching import ServerState


class LargeMapLocaliser(FleetLocaliser):
    """Localises one robot in a large map in memory; see `FleetLocaliser`.

    The map is not looked at again: who wants a changed file opens it anew, as with any file.
    """

    @classmethod
    def of(
        cls, loaded: LoadedMap, config: LocaliserConfig | None = None, limits: ShortlistConfig | None = None
    ) -> LargeMapLocaliser:
        """In a map that is there whole; see the base class for the rest."""
        localiser = cls(Link(LoadedSource(loaded), np.random.default_rng(0)), config, limits)
        localiser.refresh()
        return localiser

    def server(self) -> ServerState | None:
        """There is none."""
        return None
