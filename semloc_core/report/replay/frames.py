"""What a page plays: one frame an answer, short enough that an hour of them fits into a page.

Lengths are metres, rounded to centimetres; angles radians; nats and shares rounded to hundredths and thousandths.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.explain import evidence_of, place_evidence
from semloc_core.graph import Floats, storey_at
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Evidence as Found
from semloc_core.matching import Located
from semloc_core.text import short_repr

CANDIDATES = 6
"""Places of an answer that are far enough apart to be different answers, at most."""
WORTH = 0.05
"""Nats below which an object that was missed is not named; the score counts it all the same."""
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
            x, y, _ = _cm(graph.places[id_])
            places.append((x, y, on[id_] if id_ in on else storey(graph.places[id_])))
        objects = []
        for id_ in sorted(graph.objects):
            thing = graph.objects[id_]
            x, y, _ = _cm(thing.position)
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


def candidates_of(answer: wire.PlaceMatches, buildings: Buildings) -> list[Candidate]:
    """The best match and whatever else the answer names that is elsewhere, likeliest first, then most alike."""
    loaded = buildings.loaded
    found: list[Candidate] = []
    listed = [("match", answer.matches), ("rival", answer.rivals), ("alike", answer.raw_matches or [])]
    for kind, matches in listed:
        for match in matches:
            storey = int(loaded.storeys[loaded.row(match.map, match.place)])
            near = any(
                of.map == match.map and of.storey == storey and math.dist(of.position, match.position) <= MATCH_RADIUS_M
                for of in found
            )
            if near or len(found) == CANDIDATES:
                continue
            made = Candidate(
                match.map, match.place, _cm(match.position), storey, round(match.probability, 3),
                round(match.similarity, 3), kind,
            )  # fmt: skip
            if match.pose is not None:
                x, y, _ = _cm(match.pose.position)
                made.pose = x, y, _turn(match.pose.yaw)
                of = match.pose.covariance
                made.covariance = round(of[0], 4), round(of[1], 4), round(of[5], 4)
            if match is answer.matches[0] and answer.transform is not None:
                x, y, z = _cm(answer.transform.translation)
                made.laid = x, y, z, round(answer.transform.yaw, 4)
            found.append(made)
    return found


def see(frame: Frame, said: wire.ClassAttributions, buildings: Buildings) -> None:
    """Put the evidence that was published with an answer into its frame."""
    frame.because = _shares(said)
    if not frame.candidates or said.match_map is None:
        return
    order = sorted(said.objects, key=lambda of: of.id)
    frame.seen = [(of.id, of.class_, None) for of in order]
    missed = said.missed or []
    score = sum(of.score for of in (*said.objects, *missed)) + (said.walls or 0.0)
    best = frame.candidates[0]
    best.evidence = _evidence(buildings, best.map, frame, score, said.objects, missed, said.walls or 0.0)


def look(frame: Frame, said: wire.ClassAttributions) -> None:
    """Put what the encoder looked at, or another explainer says, into an answer's frame."""
    frame.attention, frame.method = _shares(said), said.method


def weigh(frame: Frame, located: Located, buildings: Buildings) -> None:
    """Take the test apart at each candidate of a frame; `located` is the core's answer to the same update."""
    if located.evidence is None:
        return
    seen, names = (
        located.evidence.fragment,
        (*located.map.model.labelspace.classes, wire.NAMELESS),
    )  # index -1 is the last
    at = seen.objects + seen.origin
    order = sorted(range(len(seen.object_ids)), key=lambda i: seen.object_ids[i])
    same = [id_ for id_, _, _ in frame.seen] == [seen.object_ids[i] for i in order]
    frame.seen = [(seen.object_ids[i], names[int(seen.classes[i])], _cm(at[i].tolist())) for i in order]
    for number, candidate in enumerate(frame.candidates):
        if number == 0 and candidate.evidence is not None and same:
            continue  # as it was published
        row = located.map.row(candidate.map, candidate.place)
        found = evidence_of(located, row)
        assert found is not None
        said = place_evidence(located.map, found)
        candidate.evidence = _evidence(
            buildings, candidate.map, frame, said.score, said.objects, said.missed, said.walls
        )
        if number > 0 or candidate.laid is None:
            _lay(candidate, found, located.map.positions[row], frame.candidates[0])


def _lay(candidate: Candidate, found: Found, place: Floats, best: Candidate) -> None:
    """Lay the run's frame, and the robot, where a candidate's evidence has them."""
    turn = np.exp(1j * found.heading)
    origin = found.fragment.origin
    moved = complex(*(place[:2] + found.shift)) - turn * complex(*origin[:2])
    x, y, z = _cm((moved.real, moved.imag, place[2] - origin[2]))
    candidate.laid = x, y, z, round(math.remainder(found.heading, 2 * math.pi), 4)
    if best.laid is None or best.pose is None:
        return
    back = np.exp(-1j * best.laid[3]) * (complex(*best.pose[:2]) - complex(*best.laid[:2]))
    x, y, _ = _cm(((moved + turn * back).real, (moved + turn * back).imag, 0.0))
    heading = best.pose[2]
    turned = None if heading is None else math.remainder(heading - best.laid[3] + found.heading, 2 * math.pi)
    candidate.pose = x, y, _turn(turned)


def _evidence(
    buildings: Buildings,
    building: str,
    frame: Frame,
    score: float,
    objects: Iterable[wire.ObjectAttribution],
    missed: Iterable[wire.ObjectAttribution],
    walls: float,
) -> Evidence:
    by_id = {of.id: of for of in objects}
    of_seen = [by_id.get(id_) for id_, _, _ in frame.seen]
    return Evidence(
        score=round(score, ROUND_NATS),
        nats=[0.0 if of is None else round(of.score, ROUND_NATS) + 0.0 for of in of_seen],
        mapped=[-1 if of is None else buildings.number(building, of.mapped) for of in of_seen],
        missed=[
            (buildings.number(building, of.id), round(of.score, ROUND_NATS)) for of in missed if of.score <= -WORTH
        ],
        walls=round(walls, ROUND_NATS) + 0.0,
    )


def _shares(said: wire.ClassAttributions) -> list[Share]:
    return [
        (of.class_, round(math.copysign(of.share, of.score), 3)) for of in said.classes if round(of.share, 3) >= 0.001
    ]


def _cm(position: Sequence[float]) -> Where:
    x, y, z = (round(float(value), ROUND_M) + 0.0 for value in position)
    return x, y, z


def _turn(yaw: float | None) -> float | None:
    return None if yaw is None else round(yaw, 3) + 0.0
