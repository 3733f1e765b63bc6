"""What compiled functions read of a map and of a fragment: arrays only, each in one piece."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.text import short_repr

Floats32 = NDArray[np.float32]
Ints32 = NDArray[np.int32]
Bools = NDArray[np.bool_]


@short_repr
class MapTable(NamedTuple):
    """A map of M places and K objects: of `MappedLayout`, and of its `Around` in the order given there."""

    x: Floats
    y: Floats
    z: Floats
    building: Ints
    place_start: Ints
    start: Ints
    objects: Ints32
    classes: Ints32
    metres: Floats32
    bearing: Floats32
    up: Floats32
    object_x: Floats
    object_y: Floats
    object_z: Floats
    odds: Floats
    detected: Floats


@short_repr
class SeenTable(NamedTuple):
    """A fragment's (n, 3) objects, their (n,) classes and ages, (n, C) weights; C = 0 where each is of its class."""

    objects: Floats
    classes: Ints
    ages: Floats
    weights: Floats


@short_repr
class Looked(NamedTuple):
    """(X, Y, Z) cells near places that the robot knows, the corner of the first but for the rim, and how wide they are.

    As of `pose.expected_objects.seen_cells`.
    """

    cells: Bools
    low: Floats
    cell_m: Floats
    rim: int


@short_repr
class PairTable(NamedTuple):
    """Mapped pairs of objects: building, direction (…, 2) and as steps, middle (…, 2), its height, rise.

    And of each building the corner (B, 2), and where its places begin (B + 1,), with these places, metres.
    """

    building: Ints
    off: Floats
    steps: Floats
    middle: Floats
    z: Floats
    rise: Floats
    corner: Floats
    place_start: Ints
    place_x: Floats
    place_y: Floats
    place_z: Floats


@short_repr
class Alike(NamedTuple):
    """Seen pairs of objects, and the run of mapped pairs that are like each.

    Args:
        i, j: (S,) numbers of the seen objects.
        off: (S, 2) the direction from one to the other, of length one.
        steps: (S,) the same, as so many of `HEADINGS`.
        low: (S,) where the run begins.
        number: (S,) how long it is.
        order: those that vote, the rarest first.
        worth: (S,) what each vote weighs, a whole number.

    """

    i: Ints
    j: Ints
    off: Floats
    steps: Floats
    low: Ints
    number: Ints
    order: Ints
    worth: Ints
