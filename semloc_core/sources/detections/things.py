"""What a detector sees at once, and what a builder of graphs knows of a thing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from semloc_core.graph import Floats
from semloc_core.sources.detections.frames import Rigid
from semloc_core.text import short_repr
from semloc_core.wire import NAMELESS, Position


@short_repr
class Detection(NamedTuple):
    """A thing in view.

    Attributes:
        scores: class -> score in 0 … 1; empty: it has no name.
        pose: of its box, in the sensor's frame.
        size: edge lengths of the box along its own axes, m; None where not known.
        track: id that a tracker gave it; empty: none.

    """

    scores: Mapping[str, float]
    pose: Rigid
    size: Position | None = None
    track: str = ""


@short_repr
class View(NamedTuple):
    """What a sensor saw at once.

    Attributes:
        stamp_ns: when.
        robot: pose of the robot in the graph's frame.
        sensor: pose of the sensor in the graph's frame.
        detections: in the sensor's frame; none is a view as well.
        source: the sensor's name: tracking ids are its own.
        optical: the sensor looks along z, with y down, as cameras' optical frames do; else along x, with z up.

    """

    stamp_ns: int
    robot: Rigid
    sensor: Rigid
    detections: tuple[Detection, ...]
    source: str = ""
    optical: bool = False


@short_repr
@dataclass(eq=False)
class Thing:
    """An object, published or not."""

    key: str
    position: Floats
    size: Floats | None
    weight: float
    labels: dict[str, float]
    total: float = 0.0
    sightings: int = 0
    missed: int = 0
    seen_from: set[str] = field(default_factory=set)
    parent: str = ""

    def shares(self) -> dict[str, float]:
        """Class -> share of all sightings, 6 decimals; what has no name is the rest."""
        found = {name: round(score / self.total, 6) for name, score in self.labels.items()} if self.total else {}
        return {name: share for name, share in sorted(found.items()) if share > 0}

    def class_(self) -> str:
        """The likeliest class; of equal ones the first by name."""
        shares = self.shares()
        return min(shares, key=lambda name: (-shares[name], name)) if shares else NAMELESS


@short_repr
class Seen(NamedTuple):
    """A detection in the graph's frame, checked."""

    position: Floats
    size: Floats | None
    scores: dict[str, float]
    track: str
    away: float


class Cells:
    """Keys by cell of a metre in the plane."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], set[str]] = {}

    def put(self, key: str, position: Floats) -> None:
        """Note where a thing of this key is."""
        self._cells.setdefault(_cell(position), set()).add(key)

    def drop(self, key: str, position: Floats) -> None:
        """Forget it there."""
        row = self._cells[cell := _cell(position)]
        row.discard(key)
        if not row:
            del self._cells[cell]

    def near(self, position: Floats, radius_m: float) -> Iterator[str]:
        """Keys at most so far away, and some more; in no particular order."""
        (left, low), (right, high) = _cell(position - radius_m), _cell(position + radius_m)
        if (right - left + 1) * (high - low + 1) > len(self._cells):
            for row in self._cells.values():
                yield from row
            return
        for x in range(left, right + 1):
            for y in range(low, high + 1):
                yield from self._cells.get((x, y), ())


def _cell(position: Floats) -> tuple[int, int]:
    return math.floor(position[0]), math.floor(position[1])
