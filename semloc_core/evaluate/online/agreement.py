"""How many places of the maps agree with what a robot has seen: where information runs out, whatever the encoder.

A place of a map explains an object seen if the map has one of that class at about that geodesic distance from it,
one for one; and an object of the map that is so near that it must have been in the sensor's range is explained if
one was seen. A detector errs, so that the true place leaves some unexplained too: a place agrees if it leaves no more
so than the best place within the matching radius of the truth. A guess among those that agree is right as often as
the share of them that are.

With a perfect detector the true place leaves nothing unexplained, and what agrees could be told apart only by distances
to better than two samplings of places reproduce: that share bounds any method that knows an object by its class and its
distance. With a real detector it is a yardstick and no bound: all errors count alike here, while a method may know that
some are likelier than others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.evaluate.online.fragments import stars_along
from semloc_core.graph import Floats, GraphArrays, Ints, object_distances
from semloc_core.sources import Walk

REACH_M = 30.0
TOLERANCE_M = 2.0
"""By how much two samplings of a building's places differ in an object's distance: about two edges."""


class Agreement:
    """The places of some maps, M in all, with each object's distance from each.

    Args:
        maps: the buildings.
        n_classes: C of the labelspace that they were made with.
        reach_m: objects farther off are not looked at, metres.
        tolerance_m: two distances differing by no more are the same, metres.

    """

    def __init__(
        self,
        maps: Sequence[GraphArrays],
        n_classes: int,
        reach_m: float = REACH_M,
        tolerance_m: float = TOLERANCE_M,
    ) -> None:
        self._reach, self._tolerance, self._n_classes = reach_m, tolerance_m, n_classes
        tables = [_distances(graph, n_classes, reach_m + tolerance_m) for graph in maps]
        self._sorted = [_stacked([table[c] for table in tables]) for c in range(n_classes)]

    @property
    def n_places(self) -> int:
        """M."""
        return len(self._sorted[0])

    def unexplained(self, walk: Walk, steps: Ints, range_m: float) -> Floats:
        """(K, M) how many objects each place leaves unexplained, at K steps.

        Args:
            walk: what was seen.
            steps: (K,) which steps.
            range_m: the sensor's range along the graph, metres.

        """
        batch = stars_along(walk.at(steps), self._n_classes, self._reach)
        objects, roots = batch.edge_index.numpy()
        classes = batch.features.numpy().argmax(axis=1)[objects]
        metres = batch.edge_length.numpy().astype(np.float64)
        rows = np.zeros((len(steps), self.n_places))
        for k in range(len(steps)):
            for c in range(self._n_classes):
                seen = np.sort(metres[(roots == k) & (classes == c)])
                rows[k] += self._of_class(c, seen, range_m)
        return rows

    def _of_class(self, class_: int, seen: Floats, range_m: float) -> Floats:
        """(M,) objects of a class unexplained either way, given the distances (K,) at which some were seen."""
        table, tolerance = self._sorted[class_], self._tolerance
        must = (table <= range_m - tolerance).sum(axis=1)
        if not len(seen):
            unseen: Floats = must.astype(np.float64)
            return unseen
        missing = np.zeros(len(table))
        # Both sides in rising order: the first that fits is the best to take.
        pointer = np.zeros(len(table), dtype=np.int64)
        everywhere = np.arange(len(table))
        for metres in seen:
            pointer = np.maximum(pointer, (table < metres - tolerance).sum(axis=1))
            fits = table[everywhere, pointer] <= metres + tolerance
            missing += ~fits
            pointer += fits
        for i in range(int(must.max(initial=0))):
            rows = np.flatnonzero(must > i)
            near = np.searchsorted(seen, table[rows, i] + tolerance, side="right")  # seen that could be the i-th
            missing[rows] += near <= i
        return missing


def _distances(graph: GraphArrays, n_classes: int, reach_m: float) -> list[Floats]:
    """For each class (P, n) distances of its objects from each place in rising order, infinite beyond the reach."""
    objects, places, metres = object_distances(graph, reach_m)
    table = np.full((graph.n_places, graph.n_objects), np.inf)
    table[places, objects] = metres
    return [np.sort(table[:, graph.object_classes == c], axis=1) for c in range(n_classes)]


def _stacked(tables: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(M, n + 1) rows of all tables, filled up with infinity."""
    width = max(table.shape[1] for table in tables) + 1
    return np.concatenate(
        [np.pad(table, ((0, 0), (0, width - table.shape[1])), constant_values=np.inf) for table in tables]
    )
