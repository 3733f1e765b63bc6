"""Which of the mapped objects the robot should have seen: those near places that it knows."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.building.free_space_cost import RIM
from semloc_core.matching.layout.building.objects_by_place import sums
from semloc_core.matching.layout.compiled.tables import Looked
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.local_map import Complex, There

SEEN_CELL_M = np.array([0.5, 0.5, 1.0])


def expected(mapped: MappedLayout, fragment: Fragment, there: There, turn: Complex, shift: Complex) -> Floats:
    """(T,) how many of the mapped objects that lie near known places would be detected."""
    return sums(there.which, expected_each(mapped, fragment, there, turn, shift), len(turn))


def expected_each(mapped: MappedLayout, fragment: Fragment, there: There, turn: Complex, shift: Complex) -> Floats:
    """(E,) probability of each mapped object around T places to be detected; 0 where it lies near no known place."""
    seen, low = looked_at(mapped, fragment)[:2]
    where = there.seen_from(turn, shift)
    cells = np.stack([where.real, where.imag, there.up])
    cells -= low[:, None]
    cells /= SEEN_CELL_M[:, None]
    np.floor(cells, out=cells)
    cells += RIM
    np.clip(cells, 0.0, np.array(seen.shape)[:, None] - 1.0, out=cells)
    at = (cells[0] * seen.shape[1] + cells[1]) * seen.shape[2] + cells[2]
    weight: Floats = mapped.detected[there.objects] * seen.ravel()[at.astype(np.int64)]
    return weight


def looked_at(mapped: MappedLayout, fragment: Fragment) -> Looked:
    """The cells near places that the robot knows."""
    within_m = mapped.config.seen_within_m
    found = fragment.looked.get(within_m)
    if found is None:
        found = fragment.looked[within_m] = Looked(*seen_cells(fragment.places, within_m), SEEN_CELL_M, RIM)
    return found


def seen_cells(places: Floats, within_m: float) -> tuple[NDArray[np.bool_], Floats]:
    """Cells near a known place on its floor, and the corner of the first one but for the rim."""
    reach = int(np.ceil(within_m / SEEN_CELL_M[0]))
    if not len(places):
        return np.zeros((1, 1, 1), dtype=np.bool_), np.zeros(3)
    margin = np.array([reach, reach, 1])
    low: Floats = places.min(axis=0) - margin * SEEN_CELL_M
    cells = np.floor((places - low) / SEEN_CELL_M).astype(np.int64) + RIM
    shape = cells.max(axis=0) + margin + 1 + RIM
    seen = np.zeros(shape.prod(), dtype=np.bool_)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    seen[np.add.outer(_disc(within_m) @ strides, cells @ strides)] = True
    return seen.reshape(shape), low


@lru_cache(maxsize=8)
def _disc(within_m: float) -> Ints:
    """(D, 3) steps from a cell to those within a distance in the plane, a layer up and a layer down."""
    reach = int(np.ceil(within_m / SEEN_CELL_M[0]))
    steps = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)], np.arange(-1, 2)), axis=-1).reshape(-1, 3)
    found: Ints = steps[np.hypot(steps[:, 0], steps[:, 1]) * SEEN_CELL_M[0] <= within_m]
    return found
