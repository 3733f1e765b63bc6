"""What is known around one place: objects and places relative to it, of a live graph or of a frozen one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, GraphArrays, Ints, Labelspace, SceneGraph, label_table
from semloc_core.matching.layout.compiled.tables import Looked
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.text import short_repr

CELL_M = 0.8
"""Places are thinned to one a cell of this size, so that a mapper that lays them closer has no louder voice."""
SURE = 0.5
"""Share of its class in all that an object may be, from which on it proposes places by it."""
_MOST_CELLS = 2.0**17


@short_repr
@dataclass(frozen=True, eq=False)
class Fragment:
    """The surroundings of a place, in a gravity-aligned frame with the place as its origin.

    Args:
        objects: (n, 3) float64, metres; nearest first.
        classes: (n,) int64 indices into the labelspace; -1 for an object without a name.
        object_ids: n ids.
        places: (k, 3) float64, metres; one a cell of `CELL_M`.
        origin: (3,) where the place is in the robot's frame, metres.
        ages: (n,) metres walked since each object last changed.
        drift: how much the robot's frame drifts (`graph.changes.drift.DriftMeter`); None where that is not known.
        likely: (n, C + 1) probability of each object to be of each class, in the last column of having no name; None
            where each is of its class for sure.

    """

    objects: Floats
    classes: Ints
    object_ids: tuple[str, ...]
    places: Floats
    origin: Floats
    ages: Floats
    drift: float | None = None
    likely: Floats | None = None
    looked: dict[float, Looked] = field(init=False, repr=False, default_factory=dict)
    """Where the robot has looked, by how near to a known place that is; made when it is first asked for."""

    def __post_init__(self) -> None:
        n = len(self.object_ids)
        assert self.objects.shape == (n, 3), self.objects.shape
        assert self.classes.shape == (n,), self.classes.shape
        assert self.ages.shape == (n,), self.ages.shape
        assert self.places.ndim == 2, self.places.shape

    def sure(self) -> Fragment:
        """The same with only the objects that are of their class rather than of any other."""
        if self.likely is None:
            return self
        named = self.likely[:, :-1]
        own = named[np.arange(len(named)), self.classes]
        return self._only((self.classes >= 0) & (own >= SURE * named.sum(axis=1)))

    def without(self, class_: int) -> Fragment:
        """The same with no object of a class seen."""
        return self._only(self.classes != class_)

    def _only(self, stays: NDArray[np.bool_]) -> Fragment:
        ids = tuple(id_ for id_, kept in zip(self.object_ids, stays.tolist(), strict=True) if kept)
        return replace(
            self,
            objects=self.objects[stays],
            classes=self.classes[stays],
            object_ids=ids,
            ages=self.ages[stays],
            likely=None if self.likely is None else self.likely[stays],
        )


def fragment_of_graph(
    graph: SceneGraph,
    labelspace: Labelspace,
    place: str,
    config: LayoutConfig,
    age: Callable[[str], float] | None = None,
    drift: float | None = None,
) -> Fragment:
    """The surroundings of a place of a live graph; objects of names that the labelspace lacks are left out.

    Args:
        graph: what the robot knows.
        labelspace: gives objects their class index.
        place: of the graph.
        config: how far to look.
        age: gives the metres walked since an object last changed; None: all are new.
        drift: of the robot's frame; None where it is not known.

    """
    # Sorting and copying all of a large graph at every update would cost more than the rest of the answer.
    reach, (x, y, _) = config.reach_m + 1.0, graph.places[place]
    beside = [
        key
        for key, item in graph.objects.items()
        if -reach <= item.position[0] - x <= reach and -reach <= item.position[1] - y <= reach
    ]
    beside.sort()
    items = [graph.objects[key] for key in beside]
    objects = np.array([item.position for item in items], dtype=np.float64).reshape(-1, 3)
    classes = np.array([labelspace.index(item.class_) for item in items], dtype=np.int64)
    origin = np.array(graph.places[place], dtype=np.float64)
    ages = np.zeros(len(beside)) if age is None else np.array([age(key) for key in beside], dtype=np.float64)
    likely = label_table(items, labelspace)
    return _around(origin, objects, classes, beside, graph.index.positions, config, ages, drift, likely)


def fragment_of_arrays(
    graph: GraphArrays, place: int, config: LayoutConfig, ages: Floats | None = None, drift: float | None = None
) -> Fragment:
    """The same of a frozen graph and the index of one of its places; ``ages`` (O,) of its objects, None for all new."""
    origin, ages = graph.place_positions[place], np.zeros(graph.n_objects) if ages is None else ages
    positions, classes, ids = graph.object_positions, graph.object_classes, graph.object_ids
    return _around(origin, positions, classes, ids, graph.place_positions, config, ages, drift, graph.object_labels)


def near(offsets: Floats, config: LayoutConfig) -> NDArray[np.bool_]:
    """Which of (n, 3) offsets, metres, are in reach on the same floor."""
    x, y, z = offsets.T
    found: NDArray[np.bool_] = (x * x + y * y <= config.reach_m**2) & (np.abs(z) <= config.floor_m)
    return found


def thinned(places: Floats) -> Floats:
    """One of (k, 3) places a cell of `CELL_M`, in the order of the cells: the nearest to the middle of its cell."""
    cells = np.floor(places / CELL_M)
    off = ((places - (cells + 0.5) * CELL_M) ** 2).sum(axis=1)
    number = _numbered(cells)
    order = np.lexsort((off, number))
    same = np.diff(number[order]) == 0
    if (same & (np.diff(off[order]) == 0)).any():
        # Of places as near the middle the first by its coordinates: the order in which places came has no say.
        order = np.lexsort((*places.T, off, number))
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = ~same
    kept: Floats = places[order[first]]
    return kept


def _numbered(cells: Floats) -> Floats | Ints:
    """(k,) numbers that are in the order of (k, 3) cells: by z, then y, then x."""
    if np.abs(cells).max(initial=0.0) < _MOST_CELLS / 2:
        numbers: Floats = (cells[:, 2] * _MOST_CELLS + cells[:, 1]) * _MOST_CELLS + cells[:, 0]  # exact in float64
        return numbers
    return np.unique(cells[:, ::-1], axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _around(
    origin: Floats,
    objects: Floats,
    classes: Ints,
    object_ids: list[str] | tuple[str, ...],
    places: Floats,
    config: LayoutConfig,
    ages: Floats,
    drift: float | None,
    likely: Floats | None = None,
) -> Fragment:
    offsets = objects - origin
    # An object without a name may be anything.
    told = classes >= 0 if likely is None else (likely[:, :-1] > 0).any(axis=1) | (likely[:, -1] >= 1)
    chosen = np.flatnonzero(near(offsets, config) & told)
    # Distances are rounded before they are compared: the order must not hang on a last bit.
    metres = np.round(np.linalg.norm(offsets[chosen], axis=1), 6)
    chosen = chosen[np.argsort(metres, kind="stable")[: config.most_objects]]
    room = places - origin
    return Fragment(
        objects=offsets[chosen],
        classes=classes[chosen],
        object_ids=tuple(object_ids[i] for i in chosen.tolist()),
        places=thinned(room[near(room, config)]),
        origin=origin,
        ages=ages[chosen],
        drift=drift,
        likely=None if likely is None else likely[chosen],
    )
