"""The objects of a graph that grows: detections are associated, fused, and forgotten when looked at and not seen."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from semloc_core.graph import Floats
from semloc_core.sources.detections.growth.cells import Cells, distance, rounded
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.places import JUMP_M, Places
from semloc_core.sources.detections.growth.things import Seen, Thing, View
from semloc_core.sources.detections.nav2 import short
from semloc_core.sources.hydra.write import node_id

MEMORY = 20.0
"""Sightings that a position and a histogram of labels remember."""
FARTHER = 0.05
"""What is a metre farther away may be so much farther from its object, m, up to `MOST_M`."""
MOST_M = 1.0
"""Neither distance nor size make a detection reach out by more than this."""
BULK_M = 5.0
"""An object is taken to be no larger where places that see it are looked for."""
FAINT = 1e-3
"""A class that an object was said to be in a smaller share of its sightings is dropped."""


class Objects:
    """Objects, published or not.

    Args:
        config: options.
        places: what they hang on.

    Attributes:
        things: by key.
        changed: keys of things that may have changed, or are gone, since this was emptied.

    """

    def __init__(self, config: BuilderConfig, places: Places) -> None:
        self._config, self._places = config, places
        self.things: dict[str, Thing] = {}
        self.changed: set[str] = set()
        self._cells = Cells()
        self._count = 0
        self._tracks: dict[tuple[str, str], str] = {}
        self._tracks_of: dict[str, dict[str, str]] = {}

    def see(self, view: View, seen: list[Seen]) -> None:
        """Take in what a view has, checked, and forget what it should have."""
        hit: set[str] = set()
        for one, key in zip(seen, self._associate(seen, view.source), strict=True):
            thing = self.things[key] if key else self._add(one)
            hit.add(thing.key)
            self._fuse(thing, one)
            if one.track:
                self._follow(view.source, one.track, thing.key)
        for key in sorted(set(self._looked_at(view)) - hit):
            thing = self.things[key]
            thing.missed += 1
            if thing.missed >= self._config.forget_after:
                self._forget(thing)

    def hang_all(self) -> None:
        """Hang every object anew: the places are others."""
        for key in sorted(self.things):
            thing = self.things[key]
            thing.seen_from &= self._places.position.keys()
            self._hang(thing)

    def _associate(self, seen: list[Seen], source: str) -> list[str]:
        """For each detection the object that it is of; empty: a new one. Each object once, the nearest first."""
        matched = [""] * len(seen)
        taken: set[str] = set()
        for i, one in enumerate(seen):
            key = self._tracks.get((source, one.track), "") if one.track else ""
            # Trackers give an id anew: it holds as far as an object may have moved.
            if key and key not in taken and distance(self.things[key].position, one.position) <= JUMP_M:
                matched[i] = key
                taken.add(key)
        costs = []
        for i, one in enumerate(seen):
            if matched[i]:
                continue
            reach = self._reach(one)
            for key in self._cells.near(one.position, reach):
                if (cost := _unlike(one, self.things[key], reach)) is not None:
                    costs.append((cost, i, key))
        for _, i, key in sorted(costs):
            if not matched[i] and key not in taken:
                matched[i] = key
                taken.add(key)
        return matched

    def _reach(self, one: Seen) -> float:
        """How far from an object a detection may be that is of it, m."""
        large = 0.0 if one.size is None else 0.25 * float(one.size.max())
        return self._config.association_m + min(FARTHER * one.away, MOST_M) + min(large, MOST_M)

    def _add(self, one: Seen) -> Thing:
        thing = Thing(node_id("O", self._count), one.position, one.size, 0.0, {})
        self._count += 1
        self.things[thing.key] = thing
        self._cells.put(thing.key, thing.position)
        return thing

    def _fuse(self, thing: Thing, one: Seen) -> None:
        self._cells.drop(thing.key, thing.position)
        if distance(thing.position, one.position) > self._reach(one):  # a tracking id says that it moved
            thing.weight = 0.0
        thing.take(one, MEMORY)
        self._cells.put(thing.key, thing.position)
        for name in [name for name, share in thing.labels.items() if share < FAINT * thing.total]:
            del thing.labels[name]
        thing.seen_from.add(self._places.here)
        self._hang(thing)
        self.changed.add(thing.key)

    def _follow(self, source: str, track: str, key: str) -> None:
        """From now on a tracking id is of this object, and of a source's ids only this one is."""
        was = self._tracks.get((source, track))
        if was is not None and was != key:
            del self._tracks_of[was][source]
        mine = self._tracks_of.setdefault(key, {})
        if mine.get(source, track) != track:
            del self._tracks[source, mine[source]]
        mine[source] = track
        self._tracks[source, track] = key

    def _forget(self, thing: Thing) -> None:
        self._cells.drop(thing.key, thing.position)
        for track in self._tracks_of.pop(thing.key, {}).items():
            del self._tracks[track]
        del self.things[thing.key]
        self.changed.add(thing.key)

    def _looked_at(self, view: View) -> Iterator[str]:
        """Objects that the sensor would see: in range and field of view, and nothing known is between."""
        config, turn, where = self._config, view.sensor.rotation, view.sensor.translation
        wide, high = (math.radians(value) / 2 for value in (config.horizontal_fov_deg, config.vertical_fov_deg))
        for key in self._cells.near(where, config.range_m):
            thing = self.things[key]
            x, y, z = (float(value) for value in turn.T @ (thing.position - where))
            ahead, left, up = (z, -x, -y) if view.optical else (x, y, z)
            if math.hypot(ahead, left, up) > config.range_m or abs(math.atan2(left, ahead)) > wide:
                continue
            if abs(math.atan2(up, math.hypot(ahead, left))) <= high and self._unhidden(thing, where):
                yield key

    def _unhidden(self, thing: Thing, where: Floats) -> bool:
        """Whether an object is in sight of a sensor by the grid; without one, whether it was seen from this place."""
        grid = self._places.grid
        if grid is None or not grid.at(grid.open, where[None, :2])[0]:
            return self._places.here in thing.seen_from
        return bool(grid.sight(where[None, :2], thing.position[None, :2], _short(thing))[0])

    def _hang(self, thing: Thing) -> None:
        """Hang an object on the nearest of the places that see it: by the grid, else from where it was seen."""
        places = self._places
        seen = [key for key in thing.seen_from if key in places.position]
        seen += places.seeing(thing.position, 2.0 + min(_short(thing), BULK_M), _short(thing))
        away = {key: round(distance(places.position[key], thing.position), 6) for key in seen or [places.here]}
        best = min(away, key=lambda key: (away[key], key))
        if best != thing.parent:
            thing.parent = best
            self.changed.add(thing.key)


def _short(thing: Thing) -> float:
    return short(None if thing.size is None else rounded(thing.size))


def _unlike(one: Seen, thing: Thing, reach: float) -> float | None:
    """How unlike a detection and an object are, 0 … 1; None: too unlike to be one."""
    cost = distance(one.position, thing.position) / reach
    if cost > 1.0:
        return None
    shares = thing.shares()
    common = sum(min(share, one.scores.get(name, 0.0)) for name, share in shares.items())
    most = min(sum(one.scores.values()), sum(shares.values()))
    if most > 0:  # what has no name is like anything
        cost += 0.5 * (1.0 - min(common / most, 1.0))
    if one.size is not None and thing.size is not None:
        ratio = np.log((one.size + 0.1) / (thing.size + 0.1))
        cost += 0.2 * float(np.abs(ratio).mean())
    return round(cost, 9) if cost <= 1.0 else None
