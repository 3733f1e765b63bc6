"""What receivers of updates have, and so what is to be said next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from semloc_core.sources.detections.growth.cells import distance, ordered, rounded
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.objects import Objects
from semloc_core.sources.detections.growth.places import Places
from semloc_core.sources.detections.growth.things import Thing
from semloc_core.text import short_repr
from semloc_core.wire import Object, Place, Position

MOVED_M = 0.02
"""An object that moved less is not written anew."""
MOVED_SHARE = 0.05
"""Nor is one whose labels' shares changed less."""


@short_repr
class Changes(NamedTuple):
    """The lists of an update, as `SceneGraphUpdate` has them."""

    places: list[Place]
    objects: list[Object]
    edges: list[tuple[str, str]]
    removed_nodes: list[str]
    removed_edges: list[tuple[str, str]]


class Written:
    """Places, ways and confirmed objects, as they were said to receivers.

    Args:
        config: options.
        places: that there are; `changed` and `changed_ways` are emptied here.
        objects: the same.

    """

    def __init__(self, config: BuilderConfig, places: Places, objects: Objects) -> None:
        self._confirm_after, self._places, self._objects = config.confirm_after, places, objects
        self._things: dict[str, tuple[Object, str]] = {}
        self._sites: dict[str, Position] = {}
        self._ways: set[tuple[str, str]] = set()

    def everything(self) -> Changes:
        """All that there is: receivers begin anew."""
        known, self._things, self._sites, self._ways = self._things, {}, {}, set()
        ways = {ordered(a, b) for a, others in self._places.ways.items() for b in others}
        return self._say(set(self._places.position), set(self._objects.things), ways, known)

    def changes(self) -> Changes:
        """What changed since the last time."""
        places = self._places
        return self._say(places.changed, self._objects.changed, places.changed_ways, self._things)

    def _say(
        self, places: set[str], things: set[str], ways: set[tuple[str, str]], known: dict[str, tuple[Object, str]]
    ) -> Changes:
        said = Changes([], [], [], [], [])
        for key in sorted(places):
            self._say_place(key, said)
        for key in sorted(things):
            self._say_thing(key, said, known.get(key))
        for way in sorted(ways):
            self._say_way(way, said)
        self._places.changed, self._objects.changed, self._places.changed_ways = set(), set(), set()
        return said

    def _say_place(self, key: str, said: Changes) -> None:
        if key not in self._places.position:
            if self._sites.pop(key, None) is not None:
                said.removed_nodes.append(key)
            return
        position = rounded(self._places.position[key])
        if self._sites.get(key) != position:
            self._sites[key] = position
            said.places.append(Place(key, position))

    def _say_thing(self, key: str, said: Changes, as_known: tuple[Object, str] | None) -> None:
        thing, was = self._objects.things.get(key), self._things.get(key)
        if thing is None or thing.sightings < self._confirm_after:
            if was is not None:
                del self._things[key]
                said.removed_nodes.append(key)
            return
        now = _object(thing, None if as_known is None else as_known[0])
        if was is None or now != was[0]:
            said.objects.append(now)
        if was is None or thing.parent != was[1]:
            said.edges.append((thing.parent, key))
            if was is not None and was[1] in self._sites:
                said.removed_edges.append((was[1], key))
        self._things[key] = now, thing.parent

    def _say_way(self, way: tuple[str, str], said: Changes) -> None:
        there = way[1] in self._places.ways.get(way[0], ())
        if there and way not in self._ways:
            self._ways.add(way)
            said.edges.append(way)
        elif not there and way in self._ways:
            self._ways.discard(way)
            if way[0] in self._sites and way[1] in self._sites:
                said.removed_edges.append(way)


def _object(thing: Thing, was: Object | None) -> Object:
    """As it is written; where and what it was said to be before, as long as it hardly moved or changed."""
    position, class_, shares = rounded(thing.position), thing.class_(), thing.shares()
    if was is not None and distance(np.array(was.position), thing.position) < MOVED_M:
        position = was.position
    labels = shares if len(shares) > 1 else None
    said = (was.labels if was is not None and was.class_ == class_ else None) or {}
    if said.keys() == shares.keys() and all(abs(said[name] - share) < MOVED_SHARE for name, share in shares.items()):
        labels = said or None
    return Object(thing.key, class_, position, None if thing.size is None else rounded(thing.size), labels)
