"""The scene graph as the robot knows it now: places, objects, and what connects them. No torch here."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from semloc_core.graph.geodesic import edge_length
from semloc_core.graph.place_index import PlaceIndex
from semloc_core.graph.update_check import check_update
from semloc_core.text import short_repr
from semloc_core.wire import Object, Place, Position, SceneGraphUpdate


@short_repr
@dataclass(frozen=True)
class Change:
    """What an update touched, for whoever keeps something derived from the graph.

    Args:
        full: the update was a full one. The sets say what differs from the graph before all the same: a
            publisher that repeats itself every few seconds changes nothing.
        places: places added, moved or removed.
        edges: traversability edges added, removed or of another length, as (a, b) with a < b.
        objects: objects added, changed (class, labels, position, size, parents, sightings) or removed.

    """

    full: bool = False
    places: frozenset[str] = frozenset()
    edges: frozenset[tuple[str, str]] = frozenset()
    objects: frozenset[str] = frozenset()


@short_repr
@dataclass
class SceneGraph:
    """Mutable graph state. Read the attributes freely; change them only through `apply`.

    Attributes:
        places: place id -> position (m).
        objects: object id -> the object (class name, position, size, labels).
        neighbours: place id -> {neighbouring place id: Euclidean length (m)}; symmetric; every place has a row.
        parents: object id -> places that the object has an edge to; every object has a row.
        children: place id -> objects with an edge to it; only places that have any.
        sightings: object id -> places it was explicitly seen from; only objects that have any.
        sighted: place id -> objects that were explicitly seen from it; only places that have any.
        query_place: where the robot is, as the last update said; a place of the graph or None.
        version: counts accepted updates.

    """

    places: dict[str, Position] = field(default_factory=dict)
    objects: dict[str, Object] = field(default_factory=dict)
    neighbours: dict[str, dict[str, float]] = field(default_factory=dict)
    parents: dict[str, set[str]] = field(default_factory=dict)
    children: dict[str, set[str]] = field(default_factory=dict)
    sightings: dict[str, set[str]] = field(default_factory=dict)
    sighted: dict[str, set[str]] = field(default_factory=dict)
    query_place: str | None = None
    version: int = 0
    _index: PlaceIndex | None = field(default=None, compare=False, repr=False)

    @classmethod
    def from_update(cls, update: SceneGraphUpdate) -> SceneGraph:
        """The graph that an update makes of an empty one.

        Raises:
            GraphError: as `apply`.

        """
        graph = cls()
        graph.apply(update)
        return graph

    @classmethod
    def of(
        cls,
        places: Iterable[Place] = (),
        objects: Iterable[Object] = (),
        edges: Iterable[tuple[str, str]] = (),
        sightings: Iterable[tuple[str, str]] = (),
    ) -> SceneGraph:
        """The graph of these nodes, their edges and (place, object) sightings; errors as of `apply`."""
        graph = cls()
        graph.amend(places, objects, edges, sightings)
        return graph

    def amend(
        self,
        places: Iterable[Place] = (),
        objects: Iterable[Object] = (),
        edges: Iterable[tuple[str, str]] = (),
        sightings: Iterable[tuple[str, str]] = (),
        removed_nodes: Iterable[str] = (),
    ) -> Change:
        """`apply` a delta of these; the query place stays."""
        return self.apply(
            SceneGraphUpdate(
                schema="semloc/scene_graph_update/1",
                stamp_ns=0,
                frame_id="",
                seq=0,
                full=False,
                places=list(places),
                objects=list(objects),
                edges=list(edges),
                query_place=self.query_place,
                sightings=list(sightings),
                removed_nodes=list(removed_nodes),
            )
        )

    def apply(self, update: SceneGraphUpdate) -> Change:
        """Apply an update, all or nothing; a delta costs what it changes, whatever the graph's size.

        A full update replaces everything. A delta removes edges, removes nodes (with their edges, parent links and
        sightings), upserts nodes, adds edges and adds sightings, in this order, so an object whose sightings are
        out of date is removed and given again in one update. Removing what is not there is no error: streams
        repeat themselves. A removed edge between a place and an object is a parent link, never a sighting.

        Args:
            update: the message; ``seq`` and stamp are the caller's business.

        Returns:
            What was touched.

        Raises:
            GraphError: duplicate ids, a node that changes its kind, an edge between objects or to itself or to
                an unknown node, a sighting that is not (place, object), a query place that is not a place of
                the resulting graph, a position that is not finite or more than 10⁹ m away. The graph is
                then as it was.

        """
        check_update(update, self.places, self.objects)
        change = self._replace(update) if update.full else self._amend(update)
        self.query_place = update.query_place
        self.version += 1
        if self._index is not None:
            self._index.update(self.neighbours, self.places, change.places.union(*change.edges))
        return change

    @property
    def index(self) -> PlaceIndex:
        """The traversability graph laid out for fast search; made when first asked for, then kept up to date."""
        if self._index is None:
            self._index = PlaceIndex(self.neighbours, self.places)
        return self._index

    def to_update(self, seq: int, stamp_ns: int, frame_id: str, query_place: str | None = None) -> SceneGraphUpdate:
        """The whole graph as a full update, in canonical order (ids sorted as strings).

        Args:
            seq: of the message.
            stamp_ns: of the message.
            frame_id: of the positions.
            query_place: where the robot is; None takes the graph's own.

        """
        edges = sorted((a, b) for a, row in self.neighbours.items() for b in row if a < b)
        links = sorted((place, child) for place, objects in self.children.items() for child in objects)
        return SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=stamp_ns,
            frame_id=frame_id,
            seq=seq,
            full=True,
            places=[Place(id=p, position=self.places[p]) for p in sorted(self.places)],
            objects=[self.objects[o] for o in sorted(self.objects)],
            edges=edges + links,
            query_place=self.query_place if query_place is None else query_place,
            sightings=sorted((place, seen) for place, objects in self.sighted.items() for seen in objects),
        )

    def _replace(self, update: SceneGraphUpdate) -> Change:
        new = SceneGraph()
        new._amend(update)
        change = _difference(self, new)
        for name in ("places", "objects", "neighbours", "parents", "children", "sightings", "sighted"):
            setattr(self, name, getattr(new, name))
        return change

    def _amend(self, update: SceneGraphUpdate) -> Change:
        touched = _Touched()
        if not update.full:
            for a, b in update.removed_edges:
                self._remove_edge(a, b, touched)
            for node in update.removed_nodes:
                self._remove_node(node, touched)
        for place in update.places:
            self._put_place(place.id, place.position, touched)
        for thing in update.objects:
            if self.objects.get(thing.id) != thing:
                self.objects[thing.id] = thing
                self.parents.setdefault(thing.id, set())
                touched.objects.add(thing.id)
        for a, b in update.edges:
            self._add_edge(a, b, touched)
        for place_id, seen in update.sightings:
            if _link(self.sightings, self.sighted, seen, place_id):
                touched.objects.add(seen)
        return Change(False, frozenset(touched.places), frozenset(touched.edges), frozenset(touched.objects))

    def _put_place(self, place: str, position: Position, touched: _Touched) -> None:
        if self.places.get(place) == position:
            return
        self.places[place] = position
        touched.places.add(place)
        row = self.neighbours.setdefault(place, {})
        for other in row:
            length = edge_length(position, self.places[other])
            if length != row[other]:
                row[other] = self.neighbours[other][place] = length
                touched.edges.add(_ordered(place, other))

    def _add_edge(self, a: str, b: str, touched: _Touched) -> None:
        if a in self.places and b in self.places:
            if b not in self.neighbours[a]:
                length = edge_length(self.places[a], self.places[b])
                self.neighbours[a][b] = self.neighbours[b][a] = length
                touched.edges.add(_ordered(a, b))
            return
        place, child = (a, b) if a in self.places else (b, a)
        if place not in self.parents[child]:
            self.parents[child].add(place)
            self.children.setdefault(place, set()).add(child)
            touched.objects.add(child)

    def _remove_edge(self, a: str, b: str, touched: _Touched) -> None:
        if b in self.neighbours.get(a, ()):
            del self.neighbours[a][b], self.neighbours[b][a]
            touched.edges.add(_ordered(a, b))
            return
        place, child = (a, b) if a in self.places else (b, a)
        if place in self.parents.get(child, ()):
            self.parents[child].discard(place)
            _discard(self.children, place, child)
            touched.objects.add(child)

    def _remove_node(self, node: str, touched: _Touched) -> None:
        if node in self.places:
            for other in self.neighbours.pop(node):
                del self.neighbours[other][node]
                touched.edges.add(_ordered(node, other))
            for child in self.children.pop(node, ()):
                self.parents[child].discard(node)
                touched.objects.add(child)
            for seen in self.sighted.pop(node, ()):
                _discard(self.sightings, seen, node)
                touched.objects.add(seen)
            del self.places[node]
            touched.places.add(node)
        elif node in self.objects:
            for place in self.parents.pop(node):
                _discard(self.children, place, node)
            for place in self.sightings.pop(node, ()):
                _discard(self.sighted, place, node)
            del self.objects[node]
            touched.objects.add(node)


class _Touched:
    def __init__(self) -> None:
        self.places: set[str] = set()
        self.edges: set[tuple[str, str]] = set()
        self.objects: set[str] = set()


def _ordered(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)


def _link(forward: dict[str, set[str]], backward: dict[str, set[str]], a: str, b: str) -> bool:
    """Enter a -> b and b -> a; False where they were there already."""
    row = forward.setdefault(a, set())
    if b in row:
        return False
    row.add(b)
    backward.setdefault(b, set()).add(a)
    return True


def _discard(rows: dict[str, set[str]], key: str, member: str) -> None:
    """Take ``member`` out of a row; a row that is empty then goes too."""
    row = rows[key]
    row.discard(member)
    if not row:
        del rows[key]


def _difference(old: SceneGraph, new: SceneGraph) -> Change:
    """What differs between two graphs; costs their size."""
    places = {p for p in old.places.keys() | new.places.keys() if old.places.get(p) != new.places.get(p)}
    edges: set[tuple[str, str]] = set()
    for a in old.neighbours.keys() | new.neighbours.keys():
        before, after = old.neighbours.get(a, {}), new.neighbours.get(a, {})
        if before != after:
            edges |= {_ordered(a, b) for b in before.keys() | after.keys() if before.get(b) != after.get(b)}
    objects = {
        o
        for o in old.objects.keys() | new.objects.keys()
        if old.objects.get(o) != new.objects.get(o)
        or old.parents.get(o) != new.parents.get(o)
        or old.sightings.get(o) != new.sightings.get(o)
    }
    return Change(True, frozenset(places), frozenset(edges), frozenset(objects))
