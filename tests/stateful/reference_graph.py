"""What a stream of updates means, written down as plainly as it can be: sets, copied whole at each update.

Nothing here is incremental and nothing is shared with the code under test but the message types.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import msgspec

from semloc_core.wire import Object, Place, Position, SceneGraphUpdate

TOUCHING_M = 1e-9  # a distance so near the radius is at it


def makes_sense_alone(update: SceneGraphUpdate) -> bool:
    """Whether an update could fit some graph."""
    places, objects = [p.id for p in update.places], [o.id for o in update.objects]
    if len({*places, *objects}) < len(places) + len(objects):
        return False
    if any(a == b for a, b in [*update.edges, *update.removed_edges, *update.sightings]):
        return False
    if any(a in objects and b in objects for a, b in update.edges):
        return False
    if any(a in objects or b in places for a, b in update.sightings) or update.query_place in objects:
        return False
    return not update.full or ReferenceGraph().fits(update)


@dataclass(frozen=True)
class ReferenceGraph:
    """A scene graph as a value."""

    places: dict[str, Position] = field(default_factory=dict)
    objects: dict[str, Object] = field(default_factory=dict)
    edges: frozenset[frozenset[str]] = frozenset()
    links: frozenset[tuple[str, str]] = frozenset()
    sightings: frozenset[tuple[str, str]] = frozenset()
    query_place: str | None = None

    def cleared(self, update: SceneGraphUpdate) -> ReferenceGraph:
        """The graph when the update's removals are done."""
        if update.full:
            return ReferenceGraph()
        gone = set(update.removed_nodes)
        cut = {frozenset(pair) for pair in update.removed_edges}
        return ReferenceGraph(
            {p: x for p, x in self.places.items() if p not in gone},
            {o: x for o, x in self.objects.items() if o not in gone},
            frozenset(e for e in self.edges - cut if not e & gone),
            frozenset(e for e in self.links if frozenset(e) not in cut and not gone & set(e)),
            frozenset(s for s in self.sightings if not gone & set(s)),
        )

    def fits(self, update: SceneGraphUpdate) -> bool:
        """Whether an update that makes sense alone makes sense here."""
        left = self.cleared(update)
        new_places, new_objects = {p.id for p in update.places}, {o.id for o in update.objects}
        if new_places & set(left.objects) or new_objects & set(left.places):
            return False
        places, objects = new_places | set(left.places), new_objects | set(left.objects)
        if any(not {a, b} <= places | objects or not {a, b} & places for a, b in update.edges):
            return False
        if any(a not in places or b not in objects for a, b in update.sightings):
            return False
        return update.query_place is None or update.query_place in places

    def after(self, update: SceneGraphUpdate) -> ReferenceGraph:
        """The graph that an update which fits makes of this one."""
        left = self.cleared(update)
        places = left.places | {p.id: p.position for p in update.places}
        pairs = [(a, b) if a in places else (b, a) for a, b in update.edges]
        return replace(
            left,
            places=places,
            objects=left.objects | {o.id: o for o in update.objects},
            edges=left.edges | {frozenset((a, b)) for a, b in pairs if b in places},
            links=left.links | {(a, b) for a, b in pairs if b not in places},
            sightings=left.sightings | set(update.sightings),
            query_place=update.query_place,
        )

    def distances(self) -> dict[str, dict[str, float]]:
        """Between all places along edges (m), by relaxing every edge until nothing gets shorter."""
        found = {a: {b: 0.0 if a == b else math.inf for b in self.places} for a in self.places}
        changed = True
        while changed:
            changed = False
            for a, b in [tuple(e) for e in self.edges]:
                length = math.dist(self.places[a], self.places[b])
                for row in found.values():
                    for near, far in ((a, b), (b, a)):
                        if row[near] + length < row[far] - 1e-12:
                            row[far], changed = row[near] + length, True
        return found

    def visible(self, radius_m: float) -> dict[tuple[str, str], float]:
        """(place, object) pairs that see each other, and how far apart they are (m)."""
        apart, found = self.distances(), {}
        for thing in self.objects:
            seen_from = {p for p, o in self.sightings if o == thing}
            parents = [p for p, o in self.links if o == thing]
            for place in self.places:
                metres = min((apart[parent][place] for parent in parents), default=math.inf)
                if metres <= radius_m + TOUCHING_M and (not seen_from or place in seen_from):
                    found[place, thing] = min(metres, radius_m)
                elif place in seen_from:
                    found[place, thing] = radius_m
        return found

    def surroundings(self, root: str, hops: int, radius_m: float, known: set[str]) -> set[str]:
        """Nodes at most so many hops from a place, over edges and what sees what; classes not known are not there."""
        pairs = [tuple(e) for e in self.edges]
        pairs += [pair for pair in self.visible(radius_m) if self.objects[pair[1]].class_ in known]
        reached = {root}
        for _ in range(hops):
            reached |= {b for a, b in pairs if a in reached} | {a for a, b in pairs if b in reached}
        return reached

    def to_update(self, order: list[int]) -> SceneGraphUpdate:
        """The graph as one full update, its parts in an order that ``order`` (any integers) stirs."""

        def stirred(items: list) -> list:  # type: ignore[type-arg]
            return [x for _, _, x in sorted((order[i % len(order)], i, x) for i, x in enumerate(sorted(items)))]

        edges = [tuple(sorted(e, reverse=bool(order[0] % 2))) for e in self.edges]
        objects = {o: self.objects[o] for o in stirred(list(self.objects))}
        return SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            seq=0,
            full=True,
            places=[Place(p, self.places[p]) for p in stirred(list(self.places))],
            objects=[msgspec.structs.replace(thing) for thing in objects.values()],
            edges=stirred(edges + list(self.links)),
            query_place=self.query_place,
            sightings=stirred(list(self.sightings)),
        )
