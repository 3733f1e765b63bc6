"""Which places see an object when the graph gives only its parent.

An object is seen from every place whose geodesic distance (along traversability edges, so walls count) from one of
its parent places is at most a radius. Explicit sightings win: an object that has any is seen from these places
only, and from one out of reach at the radius itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from semloc_core.graph.arrays import Floats, GraphArrays, Ints
from semloc_core.graph.geodesic import ball, many_balls, ranges, repair
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.text import short_repr

_NOTHING: Mapping[str, float] = MappingProxyType({})


@short_repr
class Views(NamedTuple):
    """What an update changed: places whose view is another, in whatever it has; objects seen from elsewhere."""

    places: frozenset[str]
    objects: frozenset[str]


class Visibility:
    """Visibility of a graph that changes; an update costs what changed.

    Around every place that is an object's parent the geodesic ball of the radius is kept, and repaired where the
    graph changes (`semloc_core.graph.geodesic.repair`).

    Args:
        graph: the graph; it is read whenever `update` is called, never changed.
        radius_m: visibility radius in metres, inclusive.

    """

    def __init__(self, graph: SceneGraph, radius_m: float) -> None:
        self.graph = graph
        self.radius_m = radius_m
        self._sources: dict[str, frozenset[str]] = {}  # object -> parent places
        self._balls: dict[str, dict[str, float]] = {}  # parent place -> place -> m
        self._reached: dict[str, set[str]] = {}  # place -> parent places whose ball it is in
        self._places: dict[str, dict[str, float]] = {}  # object -> place -> m
        self._objects: dict[str, dict[str, float]] = {}  # place -> object -> m
        self.update(Change(full=True, objects=frozenset(graph.objects)))

    def objects_of(self, place: str) -> Mapping[str, float]:
        """Objects that a place sees -> distance (m), in no particular order; empty for an unknown place."""
        return self._objects.get(place, _NOTHING)

    def places_of(self, object_: str) -> Mapping[str, float]:
        """Places that see an object -> distance (m), in no particular order; empty for an unknown object."""
        return self._places.get(object_, _NOTHING)

    def update(self, change: Change) -> Views:
        """Take in what an update of the graph changed. Every change must be given, in order; several may wait.

        Args:
            change: what `SceneGraph.apply` returned.

        Returns:
            Places whose view changed (other objects, distances, or something about an object seen), and objects that
            are seen from other places, or distances, than before.

        """
        refresh = self._update_sources(change)
        for source, touched in self._touched_balls(change).items():
            moved = repair(self._balls[source], self.graph.neighbours, source, self.radius_m, touched)
            self._index(source, moved)
            for child in self.graph.children[source]:
                refresh.setdefault(child, set()).update(moved)
        changed: set[str] = set()
        moved_objects: set[str] = set()
        for object_, places in refresh.items():
            if seen_from := self._refresh(object_, places):
                changed |= seen_from
                moved_objects.add(object_)
        for object_ in change.objects:
            changed.update(self._places.get(object_, ()))
        return Views(frozenset(changed), frozenset(moved_objects))

    def _update_sources(self, change: Change) -> dict[str, set[str]]:
        """Begin and drop balls as objects come, go and change parents; object -> places to look at again."""
        refresh: dict[str, set[str]] = {}
        idle: set[str] = set()
        for object_ in change.objects:
            old = self._sources.pop(object_, frozenset())
            new = frozenset(self.graph.parents.get(object_, ()))
            if new:
                self._sources[object_] = new
            for source in new - self._balls.keys():
                self._balls[source] = ball(self.graph.neighbours, source, self.radius_m)
                self._index(source, self._balls[source])
            places = refresh[object_] = set(self._places.get(object_, ()))
            for source in new:
                places.update(self._balls[source])
            places.update(self.graph.sightings.get(object_, ()))
            idle |= old - new
        for source in idle:
            if source in self._balls and source not in self.graph.children:
                self._drop(source)
        return refresh

    def _touched_balls(self, change: Change) -> dict[str, list[str]]:
        """Parent place -> touched places in its ball; only these balls can change."""
        touched = set(change.places)
        for edge in change.edges:
            touched.update(edge)
        hit: dict[str, list[str]] = {}
        for place in touched:
            for source in tuple(self._reached.get(place, ())):
                if source in self.graph.children:
                    hit.setdefault(source, []).append(place)
                else:  # its objects went in a change that is still to come
                    self._drop(source)
        return hit

    def _index(self, source: str, places: Iterable[str]) -> None:
        distances = self._balls[source]
        for place in places:
            if place in distances:
                self._reached.setdefault(place, set()).add(source)
            else:
                self._unreach(place, source)

    def _unreach(self, place: str, source: str) -> None:
        row = self._reached[place]
        row.discard(source)
        if not row:
            del self._reached[place]

    def _drop(self, source: str) -> None:
        for place in self._balls.pop(source):
            self._unreach(place, source)

    def _refresh(self, object_: str, places: Collection[str]) -> set[str]:
        """Set the object's distance anew at these places; returns those where it changed."""
        nearest = self._nearest(object_, places)
        sightings = self.graph.sightings.get(object_)
        row = self._places.setdefault(object_, {})
        changed: set[str] = set()
        for place in places:
            distance = nearest(place)
            if sightings is not None:
                distance = None if place not in sightings else self.radius_m if distance is None else distance
            if distance == row.get(place):
                continue
            changed.add(place)
            if distance is None:
                del row[place]
                objects = self._objects[place]
                del objects[object_]
                if not objects:
                    del self._objects[place]
            else:
                row[place] = distance
                self._objects.setdefault(place, {})[object_] = distance
        if not row:
            del self._places[object_]
        return changed

    def _nearest(self, object_: str, places: Collection[str]) -> Callable[[str], float | None]:
        """Distance of each of these places from the nearest of the object's parents, None where out of reach."""
        balls = [self._balls[source] for source in self._sources.get(object_, ()) if source in self._balls]
        if len(balls) == 1:
            return balls[0].get
        if len(balls) * len(places) <= sum(map(len, balls)):
            return lambda place: min((each[place] for each in balls if place in each), default=None)
        nearest: dict[str, float] = {}
        for each in balls:
            for place, metres in each.items():
                if metres < nearest.get(place, math.inf):
                    nearest[place] = metres
        return nearest.get


def visible_pairs(arrays: GraphArrays, radius_m: float) -> tuple[Ints, Floats]:
    """All (place, object) pairs that see each other, as `Visibility` has them, for a whole building at once.

    Args:
        arrays: the building.
        radius_m: visibility radius in metres, inclusive.

    Returns:
        (2, V) place index over object index, by place, then object; (V,) geodesic distances in metres.

    """
    objects, places, distances = object_distances(arrays, radius_m)
    explicit = np.zeros(arrays.n_objects, dtype=bool)
    explicit[arrays.sightings[1]] = True
    if explicit.any():
        sighted = np.unique(_pair_keys(arrays, arrays.sightings[1], arrays.sightings[0]))
        keys = _pair_keys(arrays, objects, places)
        seen = np.isin(keys, sighted)
        far = sighted[~np.isin(sighted, keys)]
        keep = seen | ~explicit[objects]
        objects = np.concatenate([objects[keep], far // arrays.n_places])
        places = np.concatenate([places[keep], far % arrays.n_places])
        distances = np.concatenate([distances[keep], np.full(len(far), radius_m)])
    order = np.argsort(places * arrays.n_objects + objects)
    return np.stack([places[order], objects[order]]), distances[order]


def object_distances(arrays: GraphArrays, radius_m: float) -> tuple[Ints, Ints, Floats]:
    """Geodesic distance of every place to every object within a radius; sightings have no say here.

    Returns:
        (M,) object indices, (M,) place indices, (M,) metres from the object's nearest parent; by object, then place.

    """
    child, parent = arrays.object_parents
    sources, source_of_link = np.unique(parent, return_inverse=True)
    by_source, place, distance = many_balls(
        arrays.n_places, arrays.place_edges, arrays.edge_lengths(), sources, radius_m
    )
    # Each link takes the whole ball of its source: rows start[s] … start[s] + size[s] of the three arrays above.
    size = np.bincount(by_source, minlength=len(sources))
    start = np.cumsum(size) - size
    of_link = size[source_of_link]
    row = ranges(start[source_of_link], of_link)
    objects, places, distances = np.repeat(child, of_link), place[row], distance[row]
    keys = _pair_keys(arrays, objects, places)
    if (np.diff(keys) > 0).all():  # one parent each, in order: as most graphs are
        return objects, places, distances
    order = np.lexsort((distances, keys))
    first = order[np.diff(keys[order], prepend=-1) > 0]
    return objects[first], places[first], distances[first]


def _pair_keys(arrays: GraphArrays, objects: Ints, places: Ints) -> Ints:
    keys: Ints = objects * arrays.n_places + places
    return keys
