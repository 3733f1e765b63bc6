"""How well every place of a map could account for what is around the robot, by distance alone.

The likelihood of `semloc_core.observation`, its rings laid by distance as the crow flies: a fragment does not know
the short cuts yet, so that distances along its edges are too long, while straight ones are what they will remain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph_arrays import Floats, Ints
from semloc_core.layout.fragment import Fragment, thinned
from semloc_core.layout.mapped import MappedLayout, pairs_within
from semloc_core.observation import ObservationConfig, ObservationModel, Surroundings

RING_CENTRES_M = np.array([0.0, 2.0, 4.0, 6.0, 8.5, 11.5])
RING_WIDTHS_M = np.array([1.0, 1.0, 1.0, 1.2, 1.5, 1.8])
MOST_PLACES = 50_000
"""A map with more places is not scanned: the embedding alone proposes."""
_PLACES_AT_ONCE = 2048


class CoarseScan:
    """Made once for a map (tens of microseconds a place).

    Args:
        mapped: the map; at most `MOST_PLACES` places, or it is slow and large.

    """

    def __init__(self, mapped: MappedLayout) -> None:
        self._n_classes, self._reach = mapped.n_classes, mapped.config.reach_m
        objects = np.zeros((mapped.n_places, mapped.n_classes, len(RING_CENTRES_M)), dtype=np.float32)
        room = np.zeros((mapped.n_places, len(RING_CENTRES_M)), dtype=np.float32)
        start, found = mapped.objects_near
        for first in range(0, mapped.n_places, _PLACES_AT_ONCE):
            last = min(first + _PLACES_AT_ONCE, mapped.n_places)
            chosen = slice(int(start[first]), int(start[last]))
            owner = np.repeat(np.arange(first, last), np.diff(start[first : last + 1]))
            self._count_objects(objects, mapped, owner, found[chosen])
        for building in np.unique(mapped.building).tolist():
            rows = np.flatnonzero(mapped.building == building)
            free = thinned(mapped.free_space(building))
            for part in np.array_split(rows, max(1, len(rows) // _PLACES_AT_ONCE)):
                here = mapped.positions[part]
                i, j = pairs_within(here, free, self._reach, mapped.config.floor_m)
                _add(room, part[i], _shares(_metres(here[i] - free[j])))
        self._model = ObservationModel(Surroundings(objects, room), ObservationConfig())

    def log_likelihood(self, fragment: Fragment) -> NDArray[np.float32]:
        """(M,) of each place of the map, up to a constant."""
        objects = np.zeros((1, self._n_classes, len(RING_CENTRES_M)), dtype=np.float32)
        np.add.at(objects[0], fragment.classes, _shares(_metres(fragment.objects)))
        room = _shares(_metres(fragment.places)).sum(axis=0, keepdims=True)
        found: NDArray[np.float32] = self._model.log_likelihood(Surroundings(objects, room))[0]
        return found

    def _count_objects(self, counts: NDArray[np.float32], mapped: MappedLayout, rows: Ints, objects: Ints) -> None:
        offsets = mapped.object_positions[objects] - mapped.positions[rows]
        metres = _metres(offsets)
        near = (metres <= self._reach) & (np.abs(offsets[:, 2]) <= mapped.config.floor_m)
        np.add.at(counts, (rows[near], mapped.object_classes[objects[near]]), _shares(metres[near]))


def _metres(offsets: Floats) -> Floats:
    found: Floats = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return found


def _shares(metres: Floats) -> NDArray[np.float32]:
    """(K, R) float32 shares of K distances (m) in the rings; rows sum to 1."""
    log = -0.5 * ((metres[:, None] - RING_CENTRES_M) / RING_WIDTHS_M) ** 2
    weight = np.exp(log - log.max(axis=1, keepdims=True, initial=-np.inf))
    found: NDArray[np.float32] = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    return found


def _add(table: NDArray[np.float32], rows: Ints, values: NDArray[np.float32]) -> None:
    """Add (K, R) values to the given rows of a table; rows in rising order."""
    if not len(rows):
        return
    first = np.flatnonzero(np.r_[True, rows[1:] != rows[:-1]])
    table[rows[first]] += np.add.reduceat(values, first, axis=0)
