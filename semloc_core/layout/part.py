"""Buildings laid out one by one, so that verification on any few of them needs no new reading of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semloc_core.graph_arrays import Floats, GraphArrays, Ints
from semloc_core.layout.coarse import RING_CENTRES_M, affordable, count
from semloc_core.layout.config import LayoutConfig
from semloc_core.layout.mapped import Floats32, MappedLayout
from semloc_core.observation import Surroundings


@dataclass(frozen=True, eq=False)
class LayoutPart:
    """One building, ready to be joined with others (`LayoutVerifier.joined`).

    Args:
        mapped: the building.
        at: (K,) int64, where in its (M, C, R) counts of objects around places there are any: few of them.
        counts: (K,) float32, these.
        room: (M, R) float32, room around places; without places where the building is too large to be scanned.

    """

    mapped: MappedLayout
    at: Ints
    counts: Floats32
    room: Floats32

    @classmethod
    def of(cls, graph: GraphArrays, rows: Ints, n_classes: int, weights: Floats | None = None) -> LayoutPart:
        """Read a building; arguments as of `LayoutVerifier`."""
        mapped = MappedLayout([graph], [rows], n_classes, LayoutConfig(), None if weights is None else [weights])
        mapped.prepare()
        if not affordable(mapped):
            none = np.zeros(0, dtype=np.float32)
            return cls(mapped, np.zeros(0, dtype=np.int64), none, np.zeros((0, len(RING_CENTRES_M)), dtype=np.float32))
        counted = count(mapped)
        at = np.flatnonzero(counted.objects)
        return cls(mapped, at, counted.objects.ravel()[at], counted.places)


def joined_counts(parts: Sequence[LayoutPart]) -> Surroundings:
    """What `semloc_core.layout.coarse.count` makes of all of them; each of a size that can be scanned."""
    first, rings = parts[0].mapped, len(RING_CENTRES_M)
    objects = np.zeros((sum(part.mapped.n_places for part in parts), first.n_classes, rings), dtype=np.float32)
    row = 0
    for part in parts:
        objects[row : row + part.mapped.n_places].reshape(-1)[part.at] = part.counts
        row += part.mapped.n_places
    return Surroundings(objects, np.concatenate([part.room for part in parts]))
