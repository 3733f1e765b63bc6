"""How well every place of a map could account for what is around the robot, by distance alone.

The likelihood of `semloc_core.observation`, its rings laid by distance as the crow flies: a fragment does not know
the short cuts yet, so that distances along its edges are too long, while straight ones are what they will remain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph_arrays import Floats, Ints
from semloc_core.layout.fragment import Fragment, thinned
from semloc_core.layout.mapped import BLOCK_ROWS, MappedLayout, Nearby
from semloc_core.observation import ObservationConfig, ObservationModel, Surroundings

RING_CENTRES_M = np.array([0.0, 2.0, 4.0, 6.0, 8.5, 11.5])
RING_WIDTHS_M = np.array([1.0, 1.0, 1.0, 1.2, 1.5, 1.8])
MOST_PLACES = 50_000
"""A map with more places is not scanned: the embedding alone proposes."""
MOST_COUNTS = 8_000_000
"""Places times classes: a scan takes some 100 bytes for each, half of them only while it is made."""
STEP_M = 0.01
"""Shares of rings are tabled in such steps: there are many more pairs than steps."""


class CoarseScan:
    """Made once for a map (about a tenth of a millisecond a place).

    Args:
        mapped: the map; at most `MOST_PLACES` places, or it is slow and large.
        counted: what `count` makes of it, where that is known.

    """

    def __init__(self, mapped: MappedLayout, counted: Surroundings | None = None) -> None:
        self._n_classes = mapped.n_classes
        self._model = ObservationModel(count(mapped) if counted is None else counted, ObservationConfig())

    def log_likelihood(self, fragment: Fragment) -> NDArray[np.float32]:
        """(M,) of each place of the map, up to a constant."""
        objects = np.zeros((1, self._n_classes, len(RING_CENTRES_M)), dtype=np.float32)
        np.add.at(objects[0], fragment.classes, _shares(_metres(fragment.objects)))
        room = _shares(_metres(fragment.places)).sum(axis=0, keepdims=True)
        found: NDArray[np.float32] = self._model.log_likelihood(Surroundings(objects, room))[0]
        return found


def count(mapped: MappedLayout) -> Surroundings:
    """What is around each of the M places of a map; that of several maps together is that of each, one by one."""
    objects = np.zeros((mapped.n_places, mapped.n_classes, len(RING_CENTRES_M)), dtype=np.float32)
    room = np.zeros((mapped.n_places, len(RING_CENTRES_M)), dtype=np.float32)
    reach = mapped.config.reach_m
    table = _shares(STEP_M * (np.arange(round(reach / STEP_M) + 1, dtype=np.float64) + 0.5))
    for first in range(0, mapped.n_places, BLOCK_ROWS):
        _count_objects(objects[first : first + BLOCK_ROWS], mapped, first, table)
    for building, rows in enumerate(mapped.rows):
        free = thinned(mapped.free_space(building))
        here = Nearby(mapped.positions[rows], free, reach, mapped.config.floor_m)
        for first, last, i, _, metres in here.blocks():
            at = (i - first) * len(table) + _step(metres)
            counts = np.bincount(at, minlength=(last - first) * len(table)).reshape(-1, len(table))
            room[rows.start + first : rows.start + last] = counts @ table
    return Surroundings(objects, room)


def affordable(mapped: MappedLayout) -> bool:
    """Whether a scan of this map is neither slow nor large."""
    return mapped.n_places <= MOST_PLACES and mapped.n_places * mapped.n_classes <= MOST_COUNTS


def _count_objects(counts: NDArray[np.float32], mapped: MappedLayout, row: int, table: NDArray[np.float32]) -> None:
    """Add the objects around some places of the map, from a row on, to (N, C, R) counts."""
    start, objects = mapped.objects_near
    n, c, rings = counts.shape
    near = objects[start[row] : start[row + n]]
    of = np.repeat(np.arange(n), np.diff(start[row : row + n + 1]))
    offsets = mapped.object_positions[near] - mapped.positions[row + of]
    metres = _metres(offsets)
    close = (metres <= mapped.config.reach_m) & (np.abs(offsets[:, 2]) <= mapped.config.floor_m)
    stays = mapped.detected[near[close]] / mapped.config.detected
    shares = table[_step(metres[close])] * stays[:, None]
    at = of[close] * c + mapped.object_classes[near[close]]
    for ring in range(rings):
        counts[:, :, ring] = np.bincount(at, shares[:, ring], n * c).reshape(n, c)


def _step(metres: Floats) -> Ints:
    return (metres / STEP_M).astype(np.int64)


def _metres(offsets: Floats) -> Floats:
    found: Floats = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return found


def _shares(metres: Floats) -> NDArray[np.float32]:
    """(K, R) float32 shares of K distances (m) in the rings; rows sum to 1."""
    log = -0.5 * ((metres[:, None] - RING_CENTRES_M) / RING_WIDTHS_M) ** 2
    weight = np.exp(log - log.max(axis=1, keepdims=True, initial=-np.inf))
    found: NDArray[np.float32] = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    return found
