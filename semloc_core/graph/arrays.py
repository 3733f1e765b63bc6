"""A scene graph frozen into arrays: what training, map building and evaluation work on.

The online graph (`semloc_core.graph.scene_graph`) is dictionaries that change a little at a time; this is its snapshot,
in canonical order (ids sorted as strings), so that the same graph always gives the same arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph.geodesic import edge_lengths
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import is_nameless
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.storeys import storeys
from semloc_core.text import short_repr
from semloc_core.wire import NAMELESS, Object, Place, Position

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@short_repr
@dataclass(frozen=True, eq=False)
class GraphArrays:
    """One building.

    Args:
        name: the building's name.
        place_ids: P ids.
        place_positions: (P, 3) float64, metres.
        place_edges: (2, E) int64, each traversability edge once, first row < second row.
        object_ids: O ids.
        object_positions: (O, 3) float64, metres.
        object_classes: (O,) int64, index into the labelspace; -1 is a class the labelspace does not have.
        object_parents: (2, K) int64, object index over place index, one column for each object–place edge.
        sightings: (2, S) int64, place index over object index; an object that is here is seen from these only.
        object_labels: (O, C + 1) float64, probability of each object to be of each class, in the last column of having
            no name (`label_table`); None where each is of its class.

    """

    name: str
    place_ids: tuple[str, ...]
    place_positions: Floats
    place_edges: Ints
    object_ids: tuple[str, ...]
    object_positions: Floats
    object_classes: Ints
    object_parents: Ints
    sightings: Ints
    object_labels: Floats | None = None

    def __post_init__(self) -> None:
        p, o = self.n_places, self.n_objects
        for array, shape, dtype in (
            (self.place_positions, (p, 3), np.float64),
            (self.object_positions, (o, 3), np.float64),
            (self.object_classes, (o,), np.int64),
        ):
            assert array.shape == shape, (array.shape, shape)
            assert array.dtype == dtype, array.dtype
        for links in (self.place_edges, self.object_parents, self.sightings):
            assert links.ndim == 2, links.shape
            assert links.shape[0] == 2, links.shape
            assert links.dtype == np.int64, links.dtype
        assert self.object_labels is None or len(self.object_labels) == o, len(self.object_labels)

    @property
    def n_places(self) -> int:
        """P."""
        return len(self.place_ids)

    @property
    def n_objects(self) -> int:
        """O."""
        return len(self.object_ids)

    @cached_property
    def storeys(self) -> Ints:
        """(P,) the storey of each place (`semloc_core.graph.storeys.storeys`)."""
        return storeys(self.place_positions, self.place_edges)

    def edge_lengths(self) -> Floats:
        """(E,) Euclidean lengths of the traversability edges, metres; the same bits as in a `SceneGraph`."""
        return edge_lengths(self.place_positions, self.place_edges)

    def with_objects(self, keep: NDArray[np.bool_]) -> GraphArrays:
        """The same building with only the objects where ``keep`` (O,) bool is true."""
        new_index = np.cumsum(keep) - 1
        parents = self.object_parents[:, keep[self.object_parents[0]]]
        sightings = self.sightings[:, keep[self.sightings[1]]]
        return replace(
            self,
            object_ids=tuple(i for i, k in zip(self.object_ids, keep, strict=True) if k),
            object_positions=self.object_positions[keep],
            object_classes=self.object_classes[keep],
            object_parents=np.stack([new_index[parents[0]], parents[1]]).astype(np.int64),
            sightings=np.stack([sightings[0], new_index[sightings[1]]]).astype(np.int64),
            object_labels=None if self.object_labels is None else self.object_labels[keep],
        )

    @classmethod
    def from_scene_graph(cls, graph: SceneGraph, labelspace: Labelspace, name: str = "") -> GraphArrays:
        """Freeze a scene graph.

        Args:
            graph: the online graph; it may change afterwards.
            labelspace: gives class indices; objects of a class that it lacks get -1.
            name: the building's name.

        """
        place_ids = tuple(sorted(graph.places))
        object_ids = tuple(sorted(graph.objects))
        p_index = {p: i for i, p in enumerate(place_ids)}
        o_index = {o: i for i, o in enumerate(object_ids)}
        edges = sorted(
            (p_index[a], p_index[b]) for a, row in graph.neighbours.items() for b in row if p_index[a] < p_index[b]
        )
        parents = sorted((o_index[o], p_index[p]) for o, places in graph.parents.items() for p in places)
        sightings = sorted((p_index[p], o_index[o]) for o, places in graph.sightings.items() for p in places)
        return cls(
            name=name,
            place_ids=place_ids,
            place_positions=_rows([graph.places[p] for p in place_ids]),
            place_edges=_columns(edges),
            object_ids=object_ids,
            object_positions=_rows([graph.objects[o].position for o in object_ids]),
            object_classes=np.array([labelspace.index(graph.objects[o].class_) for o in object_ids], dtype=np.int64),
            object_parents=_columns(parents),
            sightings=_columns(sightings),
            object_labels=label_table([graph.objects[o] for o in object_ids], labelspace),
        )

    def to_scene_graph(self, labelspace: Labelspace) -> SceneGraph:
        """The same building as an online graph, to be fed as a stream or queried place by place.

        Args:
            labelspace: the one the arrays were made with. Objects of class -1 get a name that it does not have, or
                none where they have none. Sizes of objects are not known here, and None.

        """
        foreign = "other"
        while labelspace.index(foreign) >= 0:
            foreign += "?"
        names = (*labelspace.classes, foreign)  # index -1 is the last
        classes = [names[c] for c in self.object_classes.tolist()]
        labels: list[dict[str, float] | None] = [None] * self.n_objects
        if self.object_labels is not None:
            told = [_labels(row, names) for row in self.object_labels]
            nameless = (self.object_labels[:, -1] >= 1).tolist()
            classes = [NAMELESS if without else name for without, name in zip(nameless, classes, strict=True)]
            labels = [each if each and each != {name: 1.0} else None for each, name in zip(told, classes, strict=True)]
        places, objects = self.place_ids, self.object_ids
        edges = [(places[a], places[b]) for a, b in self.place_edges.T.tolist()]
        links = [(places[p], objects[o]) for o, p in self.object_parents.T.tolist()]
        return SceneGraph.of(
            [Place(i, _point(x)) for i, x in zip(places, self.place_positions, strict=True)],
            [
                Object(i, name, _point(x), labels=its)
                for i, name, x, its in zip(objects, classes, self.object_positions, labels, strict=True)
            ],
            edges + links,
            [(places[p], objects[o]) for p, o in self.sightings.T.tolist()],
        )


def label_table(items: Sequence[Object], labelspace: Labelspace) -> Floats | None:
    """(n, C + 1) what each object may be, in the last column of having no name; None where each is of its class.

    Classes that the labelspace lacks are none of those that it has.
    """
    if not any(item.labels or is_nameless(item.class_) for item in items):
        return None
    table = np.zeros((len(items), len(labelspace.classes) + 1))
    for row, item in zip(table, items, strict=True):
        labels = item.labels or ({} if is_nameless(item.class_) else {item.class_: 1.0})
        for name, p in labels.items():
            if (class_ := labelspace.index(name)) >= 0:
                row[class_] += p
        row[-1] = max(1.0 - math.fsum(labels.values()), 0.0)
    return table


def _labels(row: Floats, names: Sequence[str]) -> dict[str, float]:
    return {names[c]: float(row[c]) for c in np.flatnonzero(row[:-1]).tolist()}


def _point(row: Floats) -> Position:
    x, y, z = row.tolist()
    return x, y, z


def _rows(points: list[tuple[float, float, float]]) -> Floats:
    return np.array(points, dtype=np.float64).reshape(-1, 3)


def _columns(pairs: list[tuple[int, int]]) -> Ints:
    return np.ascontiguousarray(np.array(pairs, dtype=np.int64).reshape(-1, 2).T)
