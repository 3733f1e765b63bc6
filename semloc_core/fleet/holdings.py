"""Buildings that a robot has fetched: kept while they may be needed, and put together to a map of any few of them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Model
from semloc_core.fleet.object_votes import Key, KnownObjects
from semloc_core.fleet.source import BuildingEntry, Fetched
from semloc_core.map_database import LoadedMap, Whole, assemble, content_hash
from semloc_core.matching import LayoutPart, LayoutVerifier, layout_part, share_verifier


def key_of(entry: BuildingEntry, name: str) -> Key:
    """What tells a building as it was committed from any other."""
    return name, entry.generation


@dataclass(eq=False)
class _Held:
    """A building, and what verification needs of it, once it does."""

    fetched: Fetched
    layout: LayoutPart | None = None


class Holdings:
    """The buildings used last, up to a number of places. Not thread-safe.

    Args:
        places: how many places to keep; buildings in use may have more.

    Attributes:
        objects: of all buildings of the map, as far as they are known.

    """

    def __init__(self, places: int) -> None:
        self._most = places
        self._model_hash = ""
        self._held: OrderedDict[Key, _Held] = OrderedDict()
        self.objects = KnownObjects()

    def __contains__(self, key: Key) -> bool:
        return key in self._held

    @property
    def n_places(self) -> int:
        """Places held."""
        return sum(held.fetched.entry.n_places for held in self._held.values())

    def add(self, name: str, fetched: Fetched) -> None:
        """Keep a building."""
        self._held[key_of(fetched.entry, name)] = _Held(fetched)

    def keep_for(self, model_hash: str) -> None:
        """Let go of all that another model has embedded."""
        if model_hash != self._model_hash:
            self._held.clear()
            self.objects = KnownObjects()
            self._model_hash = model_hash

    def copy(self) -> Holdings:
        """The same buildings, in no memory of their own, for another robot of this process."""
        made = Holdings(self._most)
        made._held, made._model_hash, made.objects = self._held.copy(), self._model_hash, self.objects
        return made

    def forget_weights(self) -> None:
        """Classes weigh differently by now: what was made with the old weights is made again when it is needed."""
        for held in self._held.values():
            held.layout = None

    def ready(self, key: Key, config: LocaliserConfig) -> bool:
        """Whether a building is there with all that these options need of it."""
        held = self._held.get(key)
        return held is not None and (config.rerank != "layout" or held.layout is not None)

    def prepare(self, key: Key, name: str, model: Model, whole: Whole, config: LocaliserConfig) -> None:
        """Make what these options need of a building, if that is not there yet."""
        held = self._held[key]
        if not self.ready(key, config):
            held.layout = layout_part(self._map(name, model, whole, [held]), key[0])

    def map_of(self, keys: Sequence[Key], name: str, model: Model, whole: Whole, config: LocaliserConfig) -> LoadedMap:
        """A map of some buildings, with its verifier.

        The buildings used longest ago are let go of where there are too many.

        Args:
            keys: of buildings that are held, by rising name.
            name: of the whole map.
            model: of the whole map.
            whole: what these are a part of.
            config: says whether there is verification.

        """
        for key in keys:
            self.prepare(key, name, model, whole, config)
            self._held.move_to_end(key)
        held = [self._held[key] for key in keys]
        loaded = self._map(name, model, whole, held)
        layouts = [one.layout for one in held if one.layout is not None]
        if config.rerank == "layout" and layouts:
            share_verifier(loaded, LayoutVerifier.joined(layouts))
        self._trim(keep=len(held))
        return loaded

    @staticmethod
    def _map(name: str, model: Model, whole: Whole, held: Sequence[_Held]) -> LoadedMap:
        entries = [(one.fetched.stored.name, one.fetched.entry.digest) for one in held]
        content = content_hash(model.hash, model.labelspace.hash, entries)
        buildings = [(one.fetched.stored, one.fetched.places) for one in held]
        return assemble(name, model, buildings, content, part_of=whole)

    def _trim(self, keep: int) -> None:
        places = self.n_places
        for key in list(self._held)[: max(0, len(self._held) - keep)]:
            if places <= self._most:
                return
            places -= self._held.pop(key).fetched.entry.n_places
