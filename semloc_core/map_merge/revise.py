"""The building as it is after a traversal: objects kept, moved, added and forgotten, places added with their edges."""

from __future__ import annotations

import msgspec
import numpy as np

from semloc_core.graph import Floats, Ints, SceneGraph
from semloc_core.map_database import FIRST_SEEN, History, ObjectBelief
from semloc_core.map_merge.config import MergeConfig
from semloc_core.map_merge.persistence import Verdict
from semloc_core.map_merge.places import PlaceMatch
from semloc_core.map_merge.sides import Revision, Side
from semloc_core.map_merge.transform import Transform
from semloc_core.wire import Object, Place, Position

MOST_AVERAGED = 10
"""A position is a mean of at most so many traversals: an object that creeps is followed."""


def revise(
    mapped: Side,
    seen: Side,
    history: History,
    transform: Transform,
    places: PlaceMatch,
    confirmed: Ints,
    moved: Ints,
    verdict: Verdict,
    config: MergeConfig,
) -> Revision:
    """Write down what a traversal showed.

    Args:
        mapped: the building.
        seen: the traversal.
        history: what was believed before.
        transform: from the traversal's frame into the building's.
        places: how its places lie on the map's.
        confirmed: (2, K) objects of the map over objects of the traversal, seen where they were.
        moved: (2, M) the same, seen elsewhere.
        verdict: what became of each object of the map.
        config: options.

    """
    draft = _Draft(mapped, seen, transform, places, len(history.traversals) + 1)
    before = [history.objects.get(key, ObjectBelief()) for key in mapped.arrays.object_ids]
    now_at = dict(moved.T.tolist())
    seen_as = dict(confirmed.T.tolist())
    beliefs: dict[str, ObjectBelief] = {}
    missing = forgotten = 0
    for i, key in enumerate(mapped.arrays.object_ids):
        belief, chance = before[i], float(verdict.persistence[i])
        if i in now_at:
            draft.put_object(key, now_at[i])
            beliefs[key] = ObjectBelief(FIRST_SEEN, 1, 1)
            continue
        expected = bool(verdict.expected[i])
        missing += expected and i not in seen_as
        if chance < config.forget_below:
            draft.drop_object(key)
            forgotten += 1
            continue
        if i in seen_as:
            draft.shift_object(key, seen_as[i], min(belief.seen, MOST_AVERAGED - 1))
        beliefs[key] = ObjectBelief(min(1.0, chance), belief.seen + (i in seen_as), belief.expected + expected)
    known = {*seen_as.values(), *now_at.values()}
    fresh = [j for j in range(seen.arrays.n_objects) if j not in known]
    for j in fresh:
        key, first_look = draft.add_object(j)
        beliefs[key] = ObjectBelief(FIRST_SEEN if first_look else config.new_object, 1, 1)
    counts = {
        "confirmed": len(seen_as),
        "moved": len(now_at),
        "missing": int(missing),
        "added": len(fresh),
        "forgotten": forgotten,
        "places": len(places.new),
    }
    return Revision(draft.graph(), beliefs, counts)


class _Draft:
    """A scene graph in the making, in the building's frame."""

    def __init__(self, mapped: Side, seen: Side, transform: Transform, places: PlaceMatch, number: int) -> None:
        self._seen = seen
        self._positions = transform.apply(seen.arrays.object_positions)
        self._number = number
        graph = mapped.graph
        self._places = dict(graph.places)
        self._objects = dict(graph.objects)
        self._edges = {(a, b) for a, row in graph.neighbours.items() for b in row if a < b}
        self._parents = {key: set(row) for key, row in graph.parents.items()}
        self._sightings = {key: set(row) for key, row in graph.sightings.items()}
        ids, theirs = mapped.arrays.place_ids, seen.arrays.place_ids
        self._new = {int(i): self._name(theirs[i]) for i in places.new}
        self._place_of = {theirs[i]: ids[m] if m >= 0 else self._new[i] for i, m in enumerate(places.of_map.tolist())}
        at = transform.apply(seen.arrays.place_positions)
        for i, key in self._new.items():
            self._places[key] = _point(at[i])
        for a, b in seen.arrays.place_edges.T.tolist():
            if a in self._new and b in self._new:
                self._join(self._new[a], self._new[b])
        for a, b in places.links.T.tolist():
            self._join(self._new[a], ids[b])

    def _name(self, key: str) -> str:
        """An id of the map's own for a node of the traversal: it may well be another node's in the map."""
        name = f"{key}@{self._number}"
        while name in self._places or name in self._objects:
            name += "'"
        return name

    def _join(self, a: str, b: str) -> None:
        if a != b:
            self._edges.add((a, b) if a < b else (b, a))

    def put_object(self, key: str, j: int) -> None:
        """Put an object of the map where the traversal's object j is."""
        other = self._seen.arrays.object_ids[j]
        thing = self._objects[key]
        size = self._seen.graph.objects[other].size or thing.size
        self._objects[key] = msgspec.structs.replace(thing, position=_point(self._positions[j]), size=size)
        self._link(key, other)

    def _link(self, key: str, other: str) -> None:
        graph = self._seen.graph
        self._parents[key] = {self._place_of[place] for place in graph.parents[other]}
        self._sightings[key] = {self._place_of[place] for place in graph.sightings.get(other, ())}

    def shift_object(self, key: str, j: int, seen_before: int) -> None:
        """Take the traversal's position into the mean of an object's."""
        thing = self._objects[key]
        old = np.array(thing.position)
        mean = old + (self._positions[j] - old) / (seen_before + 1)
        self._objects[key] = msgspec.structs.replace(thing, position=_point(mean))

    def drop_object(self, key: str) -> None:
        """Take an object out."""
        for row in (self._objects, self._parents, self._sightings):
            row.pop(key, None)

    def add_object(self, j: int) -> tuple[str, bool]:
        """Add the traversal's object j; its id, and whether only the traversal has been where it stands."""
        other = self._seen.arrays.object_ids[j]
        key, thing = self._name(other), self._seen.graph.objects[other]
        self._objects[key] = Object(key, self._seen.names[j], _point(self._positions[j]), thing.size)
        self._link(key, other)
        parents = self._parents[key]
        return key, bool(parents) and parents <= set(self._new.values())

    def graph(self) -> SceneGraph:
        """The finished graph."""
        return SceneGraph.of(
            [Place(key, at) for key, at in sorted(self._places.items())],
            [self._objects[key] for key in sorted(self._objects)],
            sorted(self._edges) + sorted((p, o) for o, row in self._parents.items() for p in row),
            sorted((p, o) for o, row in self._sightings.items() for p in row),
        )


def _point(row: Floats) -> Position:
    x, y, z = row.tolist()
    return x, y, z
