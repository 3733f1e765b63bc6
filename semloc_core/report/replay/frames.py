"""What a page plays: one frame an answer, short enough that an hour of them fits into a page.

Lengths are metres, rounded to centimetres; angles radians; nats and shares rounded to hundredths and thousandths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from semloc_core.graph import storey_at
from semloc_core.map_database import LoadedMap
from semloc_core.text import short_repr

ROUND_M, ROUND_NATS = 2, 2

Where = tuple[float, float, float]


class Evidence(msgspec.Struct):
    """The test taken apart at one place: ``nats`` and ``mapped`` are of the frame's seen objects, in their order.

    Attributes:
        score: the sum, nats: objects, missed ones (all, also those not named) and walls.
        nats: what each seen object adds.
        mapped: the number of the mapped object that explains it, in its building; -1 for a stranger.
        missed: mapped objects that should have been seen: number, nats (< 0).
        walls: nats, at most 0.

    """

    score: float
    nats: list[float]
    mapped: list[int]
    missed: list[tuple[int, float]]
    walls: float


class Candidate(msgspec.Struct):
    """A place that could be the answer.

    Attributes:
        kind: ``match``, ``rival``, or ``alike``: proposed by the embedding, not listed by the answer.
        pose: x, y, yaw (None where it is not known) of the robot, were it there; None where nothing was tested.
        covariance: of x and y there, m²: xx, xy, yy.
        laid: where the run's frame lies in the building, were the robot there: x, y, z, yaw. Of places other than the
            best this, and the pose, are as the test that gives their evidence has them.

    """

    map: str
    place: str
    position: Where
    storey: int
    probability: float
    similarity: float
    kind: str
    pose: tuple[float, float, float | None] | None = None
    covariance: Where | None = None
    laid: tuple[float, float, float, float] | None = None
    evidence: Evidence | None = None


class Truth(msgspec.Struct):
    """Where the robot truly was."""

    map: str
    position: Where
    storey: int
    yaw: float | None


Share = tuple[str, float]


class Frame(msgspec.Struct):
    """One answer.

    Attributes:
        t: seconds since the first answer.
        candidates: the best match, then places of the answer that are elsewhere.
        seen: objects around the robot: id, class, and where, in the run's frame (None where that is not known).
        right: whether the best match is right; None where the truth is not known.
        off_m, off_deg: of the pose (of the match, where there is none) from the truth, in its building.
        because: share of each class in the evidence, below zero where it speaks against.
        attention: of each class in what another explainer says; ``method`` is its name.

    """

    t: float
    stamp_ns: int
    seq: int
    status: str
    candidates: list[Candidate]
    seen: list[tuple[str, str, Where | None]] = []
    truth: Truth | None = None
    right: bool | None = None
    off_m: float | None = None
    off_deg: float | None = None
    because: list[Share] = []
    attention: list[Share] = []
    method: str = ""


class Building(msgspec.Struct):
    """A building of the map, as it is drawn.

    Attributes:
        storeys: how many.
        places: x, y, storey.
        edges: numbers of places.
        objects: id, class, x, y, storey; in the order that evidence counts them.

    """

    name: str
    storeys: int
    places: list[Where]
    edges: list[tuple[int, int]]
    objects: list[tuple[str, str, float, float, int]]


@short_repr
@dataclass
class Buildings:
    """The buildings of a map, each read when it is first asked for."""

    loaded: LoadedMap
    read: dict[str, Building] = field(default_factory=dict)
    numbers: dict[str, dict[str, int]] = field(default_factory=dict)

    def get(self, name: str) -> Building:
        """One building; MapError where the map has none of that name."""
        if name in self.read:
            return self.read[name]
        loaded = self.loaded
        rows = loaded.rows_of(name)
        graph, positions, storeys = loaded.graph(name), loaded.positions[rows], loaded.storeys[rows]
        on = dict(zip(loaded.place_ids[rows], storeys.tolist(), strict=True))
        ids = sorted(graph.places)
        number = {id_: i for i, id_ in enumerate(ids)}
        several = bool(storeys.any())

        def storey(at: Sequence[float]) -> int:
            return storey_at(np.array(at, dtype=np.float64), positions, storeys) if several else 0

        places = []
        for id_ in ids:
            x, y, _ = cm(graph.places[id_])
            places.append((x, y, on[id_] if id_ in on else storey(graph.places[id_])))
        objects = []
        for id_ in sorted(graph.objects):
            thing = graph.objects[id_]
            x, y, _ = cm(thing.position)
            objects.append((id_, loaded.model.labelspace.canonical(thing.class_), x, y, storey(thing.position)))
        edges = [(number[a], number[b]) for a in ids for b in sorted(graph.neighbours[a]) if a < b]
        self.numbers[name] = {of[0]: i for i, of in enumerate(objects)}
        self.read[name] = Building(name, int(storeys.max(initial=0)) + 1, places, edges, objects)
        return self.read[name]

    def storey(self, building: str, point: Sequence[float]) -> int:
        """The storey that a point of a building is on."""
        rows = self.loaded.rows_of(building)
        storeys = self.loaded.storeys[rows]
        if not storeys.any():
            return 0
        return storey_at(np.array(point, dtype=np.float64), self.loaded.positions[rows], storeys)

    def number(self, building: str, id_: str | None) -> int:
        """Of a mapped object in its building; -1 for none."""
        self.get(building)
        return -1 if id_ is None else self.numbers[building].get(id_, -1)


def cm(position: Sequence[float]) -> Where:
    """A position (3,), rounded."""
    x, y, z = (round(float(value), ROUND_M) + 0.0 for value in position)
    return x, y, z


def turned_to(yaw: float | None) -> float | None:
    """An angle, rounded."""
    return None if yaw is None else round(yaw, 3) + 0.0
