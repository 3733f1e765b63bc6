"""Mapped objects around some places of the map, as a robot beside these places would have them.

The plane's points are complex numbers: a turn is a factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.tables import SeenTable
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.text import short_repr

Complex = NDArray[np.complex128]


@short_repr
@dataclass(frozen=True, eq=False)
class There:
    """Mapped objects around T places: E in all, by place.

    Args:
        which: (E,) the place.
        objects: (E,) the object.
        classes: (E,) theirs.
        offset: (E,) complex, metres from the place in the plane.
        up: (E,) metres above it.

    """

    which: Ints
    objects: NDArray[np.int32]
    classes: NDArray[np.int32]
    offset: Complex
    up: Floats

    def seen_from(self, turn: Complex, shift: Complex) -> Complex:
        """(E,) where the robot has them: its pose is (T,) turns of length one, and shifts from the places."""
        back = np.conj(turn)
        return self.offset * back[self.which] - (shift * back)[self.which]


def around_rows(mapped: MappedLayout, rows: Ints) -> There:
    """What is around (T,) rows of the map."""
    which, at = mapped.around.of_places(rows)
    objects = mapped.around.objects[at]
    offset = np.empty(len(at), dtype=np.complex128)
    offset.real, offset.imag, up = (
        there[objects] - here[which]
        for there, here in zip(mapped.object_positions.T, mapped.positions[rows].T, strict=True)
    )
    return There(which, objects, mapped.around.classes[at], offset, up)


def seen_table(mapped: MappedLayout, fragment: Fragment) -> SeenTable:
    """A fragment's objects as compiled functions read them."""
    weights = np.zeros((0, 0)) if fragment.likely is None else mapped.weights(fragment.likely)
    return SeenTable(np.ascontiguousarray(fragment.objects), fragment.classes, fragment.ages, weights)
