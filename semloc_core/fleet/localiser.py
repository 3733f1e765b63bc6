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
from semloc_core.fleet.holdings import Holdings, key_of
from semloc_core.fleet.link import Link
from semloc_core.fleet.narrowing import ANEW_M, ANEW_OBJECTS, SURE, ShortlistConfig, shortlist
from semloc_core.fleet.object_votes import Key, seen_objects
from semloc_core.fleet.source import Catalogue
from semloc_core.graph import Labelspace, Outcome, Reading, SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, Whole, assemble, in_the_words_of, matching_buildings
from semloc_core.matching import Located, Reply, ServerState
from semloc_core.wire import MapInfo, SceneGraphUpdate, decode_update

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
        self._looked: tuple[SceneGraph, float, int] | None = None
        self._complete = False
        super().__init__(_nothing(link.name), config or LocaliserConfig(), said)
        self.map_info = self._model_info = None

    # -- what differs from a map in memory -----------------------------------------------------------------------

    def apply(self, update: SceneGraphUpdate | bytes | str) -> Outcome:
        """As of `Localiser`; with a full update the list is looked at again."""
        if not isinstance(update, SceneGraphUpdate):
            update = decode_update(update, self.config.max_update_bytes)
        outcome = super().apply(update)
        if update.full:
            self._looked = None
        return outcome

    def _locate(self, place: str | None, observed: bool) -> Located:
        graph = self.live.graph
        if graph is None:
            return super()._locate(place, observed)
        try:
            self.refresh()
            query = self.live.query(place, self.map)
            if query.encoded is not None and query.place is not None:
                self._focus(query.encoded.embedding[0].numpy(), query.place)
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

    def _focus(self, z: NDArray[np.float32], place: str) -> None:
        """Answer from the buildings that are most like what the robot sees from a place, (D,) embedded."""
        until, model = time.monotonic() + self._patience_s, self.map.model
        for _ in range(_ROUNDS):
            names = self._proposed(z, place)
            keys = self._fetched(names, until) if names is not None else None
            if keys is not None:
                if keys != self._keys:
                    self._show(keys)
                return
            self.refresh()
            if self.map.model is not model:
                raise MapUnavailableError("expected the map that the query was embedded for (got one built anew)")
        raise MapUnavailableError("expected a map that stands still for an answer (got one that changes all the time)")

    def _proposed(self, z: NDArray[np.float32], place: str) -> Sequence[str] | None:
        """Names, the likeliest first; None where the map is not what it was."""
        limits, sizes, listed = self._limits, self._sizes, self.map.buildings
        if len(sizes) <= limits.buildings and sum(sizes.values()) <= limits.places:
            return tuple(sizes)
        believed = self._filter.buildings(BELIEVED) if self._filter is not None else ()
        kept = self._complete and sizes.keys() >= set(listed) and set(listed) >= {*believed} & sizes.keys()
        graph, walked = self.live.graph, self.live.ages.walked
        assert graph is not None
        if kept and self._looked is not None:
            same, metres, objects = self._looked
            if same is graph and walked - metres < ANEW_M and len(graph.objects) < ANEW_OBJECTS * objects:
                return listed
        votes = self._votes(graph, place)
        similar = self._link.similar(z, limits.nearest, tuple(sizes) if self.config.buildings else None)
        if votes is None or similar is None:
            return None
        names = shortlist(similar, votes, sizes, self.map.model.temperature, limits, believed)
        self._looked = graph, walked, len(graph.objects)
        best = [name for name in names if name not in believed][: math.ceil(SURE * len(names))]
        return listed if kept and set(listed) >= set(best) else names

    def _votes(self, graph: SceneGraph, place: str) -> Mapping[str, float] | None:
        """What the objects seen from a place say for each building whose objects are known; None as of `_proposed`."""
        assert self._catalogue is not None
        keys = [key_of(self._catalogue.buildings[name], name) for name in self._sizes]
        space = self.map.model.labelspace
        known = self.holdings.objects.votes(keys, len(space), self._link.objects)
        if known is None:
            return None
        names, votes = known
        return dict(zip(names, votes.scores(*seen_objects(graph, space, place)).tolist(), strict=True))

    def _fetched(self, names: Sequence[str], until: float) -> tuple[Key, ...] | None:
        """Keys of what is held of these, by name; None where the map is not what it was."""
        assert self._catalogue is not None
        keys: list[Key] = []
        made = 0  # one at least an answer
        for name in names:
            key = key_of(self._catalogue.buildings[name], name)
            ready = self.holdings.ready(key, self.config)
            if keys and made and not ready and time.monotonic() > until:
                continue
            made += not ready
            if key not in self.holdings:
                fetched = self._link.fetch(name)
                if fetched is None:
                    return None
                self.holdings.add(name, fetched)
                if key not in self.holdings:
                    return None
            self.holdings.prepare(key, self._link.name, self.map.model, self._whole, self.config)
            keys.append(key)
        self._complete = len(keys) == len(names)
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
