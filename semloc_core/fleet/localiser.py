"""Localisation in a map that a server keeps: it narrows the map to a few buildings, the robot does the rest by itself.

Read `FleetLocaliser._locate`. What answers is the usual `Localiser`, on the map of the buildings that are most like
the robot's surroundings; the server is asked which these are, and for each of them once.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Model, build_encoder
from semloc_core.errors import LabelspaceError, MapError, MapUnavailableError
from semloc_core.fleet.holdings import Holdings, Key, key_of
from semloc_core.fleet.link import Link
from semloc_core.fleet.narrowing import ShortlistConfig, shortlist
from semloc_core.fleet.source import Catalogue
from semloc_core.graph import Labelspace, Reading
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, Whole, assemble, in_the_words_of, matching_buildings
from semloc_core.matching import Located, Reply, ServerState
from semloc_core.wire import MapInfo

BELIEVED = 0.05
"""A building that a filter gives so much belief stays on the list, whatever the last query was like."""
_ROUNDS = 4


class FleetLocaliser(Localiser):
    """Localises one robot in a map that a server keeps.

    An answer is given only while the server answers; without it there is none (``no_graph``: no map), and the graph
    goes on being updated; with a link that waits (`Link.outage_s`) the update raises MapError
    instead. Until the server has answered for the first time it is not even known which model the map has.

    Args:
        link: to the map; closed with the localiser.
        config: options.
        limits: of the list of buildings.
        patience_s: how long one answer may fetch and read buildings; those that are not there by then are for later
            answers. Replays wait for all: their answers must not hang on the time.
        holdings: buildings that are there already.
        said: as of `Localiser`.

    Attributes:
        holdings: the buildings fetched so far.

    """

    def __init__(
        self,
        link: Link,
        config: LocaliserConfig | None = None,
        limits: ShortlistConfig | None = None,
        patience_s: float = math.inf,
        holdings: Holdings | None = None,
        said: Reading | None = None,
    ) -> None:
        self._link, self._limits, self._patience_s = link, limits or ShortlistConfig(), patience_s
        self.holdings = holdings or Holdings(self._limits.kept_places)
        self._catalogue: Catalogue | None = None
        self._sizes: Mapping[str, int] = {}
        self._keys: tuple[Key, ...] = ()
        super().__init__(_nothing(link.name), config or LocaliserConfig(), said)
        self.map_info = self._model_info = None

    # -- what differs from a map in memory -----------------------------------------------------------------------

    def _locate(self, place: str | None, observed: bool) -> Located:
        graph = self.live.graph
        if graph is None:
            return super()._locate(place, observed)
        try:
            self.refresh()
            query = self.live.query(place, self.map)
            if query.encoded is not None:
                self._focus(query.encoded.embedding[0].numpy())
        except MapError as error:
            if self._link.outage_s:  # who waited for the server does not go on without it
                raise
            query = self.live.unasked(place or graph.query_place, str(error))
            return Reply(query, self.map, self.config, self.map_info, self._model_info).nothing("no_graph")
        return self._answer(query, observed)

    @property
    def buildings(self) -> tuple[str, ...]:
        """Names of the buildings that an answer can be in: of the whole map, as far as ``buildings`` lets them in."""
        return tuple(self._sizes)

    def renewed(self, config: LocaliserConfig | None = None) -> FleetLocaliser:
        """As `Localiser.renewed`: on the same link, with what has been fetched."""
        said = self._said_by(config)
        other = config or self.config
        if said is None and self._catalogue is not None:
            said = Reading.of(other.labelspace or None, other.synonyms or None)
            in_the_words_of(self.map, said)  # what the map has no class for is refused here
        made = type(self)(self._link.shared(), other, self._limits, self._patience_s, self.holdings, said)
        made.map_info, made._model_info = self.map_info, self._model_info
        return made

    def keep_up(self) -> None:
        """See whether the map has changed, or whether its server is there again."""
        with contextlib.suppress(MapError):  # the link remembers it, and `server` tells
            self.refresh()

    def server(self) -> ServerState | None:
        """How the server does."""
        link, loaded = self._link, self.map
        values = {
            "buildings on the list": ", ".join(loaded.buildings) or "none",
            "places on the list": str(loaded.n_places),
            "last answer of the server took (ms)": f"{1e3 * link.took_s:.1f}",
        }
        if link.failure:
            values |= {"lost for (s)": f"{link.lost_s():.0f}", "asked again in (s)": f"{link.pause_s():.0f}"}
            return ServerState(False, f"no map for {link.lost_s():.0f} s: {link.failure}", values)
        info = self.map_info
        whole = f"{info.places} places in {len(self._sizes)} buildings" if info is not None else "not asked yet"
        return ServerState(True, f"map {link.name}: {whole}, answers from {len(loaded.buildings)} of them", values)

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    # -- the map as it is now --------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """See what the map is by now.

        Raises:
            MapUnavailableError: its server does not answer.
            MapError: it is damaged, or has none of the buildings asked for.

        """
        model, catalogue = self._link.refresh()
        if catalogue is self._catalogue and model is self.map.model:
            return
        names = matching_buildings(catalogue.buildings, self.config.buildings)
        changes = tuple(entry.changes for entry in catalogue.buildings.values() if entry.changes)
        before = self.map.part_of
        if model is not self.map.model:
            self._check_words(model)
        whole = self._whole = Whole(catalogue.content_hash, catalogue.n_places, changes, tuple(catalogue.buildings))
        self._catalogue = catalogue
        self._sizes = {name: catalogue.buildings[name].n_places for name in names}
        if model is not self.map.model:
            self.holdings.keep_for(catalogue.model_hash)
            self._show(())
        elif before is None or changes != before.changes:
            self.holdings.forget_weights()
            self._show(self._keys)
        self.map_info = MapInfo(name=self._link.name, hash=whole.hash, places=whole.n_places)

    def _check_words(self, model: Model) -> None:
        """Refuse a map that has no class for what is said of labels."""
        try:
            self._said.with_known(model.labelspace)
        except LabelspaceError as error:
            raise MapError(str(error)) from error

    def _read_labels(self) -> None:
        """As of `Localiser`, as soon as it is known which classes the map has."""
        if self._catalogue is not None:
            super()._read_labels()

    # -- the buildings that matter ---------------------------------------------------------------------------------

    def _focus(self, z: NDArray[np.float32]) -> None:
        """Answer from the buildings that are most like what the robot sees, (D,) embedded."""
        until, model = time.monotonic() + self._patience_s, self.map.model
        for _ in range(_ROUNDS):
            names = self._proposed(z)
            keys = self._fetched(names, until) if names is not None else None
            if keys is not None:
                if keys != self._keys:
                    self._show(keys)
                return
            self.refresh()
            if self.map.model is not model:
                raise MapUnavailableError("expected the map that the query was embedded for (got one built anew)")
        raise MapUnavailableError("expected a map that stands still for an answer (got one that changes all the time)")

    def _proposed(self, z: NDArray[np.float32]) -> Sequence[str] | None:
        """Names, the likeliest first; None where the map is not what it was."""
        limits, sizes = self._limits, self._sizes
        if len(sizes) <= limits.buildings and sum(sizes.values()) <= limits.places:
            return tuple(sizes)
        believed = self._filter.buildings(BELIEVED) if self._filter is not None else ()
        nearest = self._link.nearest(z, limits.nearest, tuple(sizes) if self.config.buildings else None)
        if nearest is None:
            return None
        return shortlist(nearest, sizes, self.map.model.temperature, limits, self.map.buildings, believed)

    def _fetched(self, names: Sequence[str], until: float) -> tuple[Key, ...] | None:
        """Keys of what is held of these, by name; None where the map is not what it was."""
        assert self._catalogue is not None
        keys: list[Key] = []
        for name in names:
            key = key_of(self._catalogue.buildings[name], name)
            if keys and time.monotonic() > until and not self.holdings.ready(key, self.config):
                continue
            if key not in self.holdings:
                fetched = self._link.fetch(name)
                if fetched is None:
                    return None
                self.holdings.add(name, fetched)
                if key not in self.holdings:
                    return None
            self.holdings.prepare(key, self._link.name, self.map.model, self._whole, self.config)
            keys.append(key)
        return tuple(sorted(keys))

    def _show(self, keys: tuple[Key, ...]) -> None:
        """Answer from these buildings, by rising name, from now on."""
        model, before = self._link.model, self.map.model
        assert model is not None
        self._serve(self.holdings.map_of(keys, self._link.name, model, self._whole, self.config))
        self._keys = keys
        if model is not before or self._said.auto:  # how often these have each class says what a name may be
            self._read_labels()


class LargeMapLocaliser(FleetLocaliser):
    """Localises one robot in a map in memory of more places than one answer can look at, narrowed in the same way.

    The map is not looked at again: who wants a changed file opens it anew, as with any file.
    """

    def server(self) -> ServerState | None:
        """There is none."""
        return None


def _nothing(name: str) -> LoadedMap:
    """The map before the server has answered: no places, by a model that nothing is ever asked of."""
    labelspace = Labelspace("none", ("none",))
    encoder = build_encoder("rings", None, len(labelspace), torch.Generator()).eval()
    return assemble(name, Model(encoder, labelspace), [], "")
