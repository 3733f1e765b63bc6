"""One building laid out for verification: made once for it, whatever maps it is part of."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.matching.layout.building.free_space_cost import Room, room_of
from semloc_core.matching.layout.building.near_pairs import BLOCK_ROWS, Nearby, nearest, uncrowded
from semloc_core.matching.layout.building.objects_by_place import Around, around_m
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.matching.layout.fragment import thinned
from semloc_core.matching.layout.pair_votes import ObjectPairs
from semloc_core.matching.layout.ring_score import RingCounter, Rings, affordable

APART_M = 1.0
"""Poses to be aligned begin at least so far apart, or turned: alignment moves them by about as much."""


class LayoutPart:
    """A building's part of a map: nothing in it depends on the map's other buildings.

    What queries need is made when it is first asked for, and kept: about a tenth of a millisecond a place.

    Args:
        graph: the building.
        rows: indices of its places that are in the map, in the order of the map's rows.
        n_classes: C.
        weights: the probability that each of its objects is still there; None: all surely are.
        config: how far surroundings count.
        storeys: (m,) of its places; None derives them from the graph.

    Attributes:
        positions: (m, 3) the places that are in the map, metres.
        places: (P, 3) all places, metres.
        object_positions: (k, 3) objects of known classes, metres.
        object_classes: (k,) of these.
        object_ids: their ids.
        detected: (k,) probability that each object is there and is detected.

    """

    def __init__(
        self,
        graph: GraphArrays,
        rows: Ints,
        n_classes: int,
        weights: Floats | None = None,
        config: LayoutConfig | None = None,
        storeys: Ints | None = None,
    ) -> None:
        self.config = config or LayoutConfig()
        self.storeys = graph.storeys[rows] if storeys is None else storeys
        self.n_classes = n_classes
        self.positions, self.places = graph.place_positions[rows], graph.place_positions
        known = (graph.object_classes >= 0) & uncrowded(graph.object_positions, self.config.reach_m)
        self.object_positions, self.object_classes = graph.object_positions[known], graph.object_classes[known]
        self.object_ids: tuple[str, ...] = tuple(graph.object_ids[i] for i in np.flatnonzero(known))
        stays = np.ones(graph.n_objects) if weights is None else weights
        self.detected: Floats = self.config.detected * stays[known]

    @classmethod
    def of(
        cls,
        graph: GraphArrays,
        rows: Ints,
        n_classes: int,
        weights: Floats | None = None,
        storeys: Ints | None = None,
    ) -> LayoutPart:
        """The same with all made that a map needs of it: none waits for it."""
        part = cls(graph, rows, n_classes, weights, storeys=storeys)
        _ = part.around, part.room, part.cells, part.pairs
        if affordable(len(part), n_classes):
            _ = part.rings
        return part

    def __len__(self) -> int:
        """How many of its places are in the map."""
        return len(self.positions)

    @cached_property
    def room(self) -> Room | None:
        """Its free space; None where that can't be laid out."""
        return room_of(self.places, self.config)

    @cached_property
    def around(self) -> Around:
        """The objects in reach of each place and a little more: `MOST_NEAR` at most."""
        config = self.config
        reach = around_m(config)
        sizes, found = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
        for first, last, i, j, metres in Nearby(
            self.positions, self.object_positions, reach, config.floor_m + 1.5
        ).blocks():
            i, j = nearest(i - first, j, metres)
            sizes.append(np.bincount(i, minlength=last - first))
            found.append(j)
        start, objects = np.cumsum(np.concatenate(sizes)), np.concatenate(found)
        return Around.of(start, objects, self.positions, self.object_positions, self.object_classes)

    @cached_property
    def pairs(self) -> ObjectPairs:
        """Pairs of its objects, by which places are proposed."""
        return ObjectPairs.of(self.object_positions, self.object_classes, self.n_classes)

    @cached_property
    def cells(self) -> Ints:
        """(m,) numbers of the cells of `APART_M` that its places are in, from 0 on."""
        cells = np.floor(self.positions / APART_M)
        found: Ints = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
        return found

    @cached_property
    def rings(self) -> Rings:
        """What is around its places by distance, for a coarse scan."""
        config, n = self.config, len(self)
        counter = RingCounter(n, self.n_classes, config.reach_m)
        start, objects = self.around.start, self.around.objects
        for first in range(0, n, BLOCK_ROWS):
            rows = slice(first, min(first + BLOCK_ROWS, n))
            near = objects[start[rows.start] : start[rows.stop]]
            of = np.repeat(np.arange(rows.stop - first), np.diff(start[first : rows.stop + 1]))
            x, y, z = (self.object_positions[near] - self.positions[first + of]).T
            metres = np.sqrt(x * x + y * y)
            close = (metres <= config.reach_m) & (np.abs(z) <= config.floor_m)
            near = near[close]
            counter.count_objects(
                rows, of[close], metres[close], self.object_classes[near], self.detected[near] / config.detected
            )
        free = Nearby(self.positions, thinned(self.places), config.reach_m, config.floor_m)
        for first, last, i, _, metres in free.blocks():
            counter.count_places(slice(first, last), i - first, metres)
        return counter.rings()
