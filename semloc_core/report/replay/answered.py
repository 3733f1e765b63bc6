"""What an answer says, and what the core makes of it, put into its frame."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.explain import evidence_of, place_evidence
from semloc_core.graph import Floats
from semloc_core.matching import Evidence as Found
from semloc_core.matching import Located
from semloc_core.report.replay.frames import ROUND_NATS, Buildings, Candidate, Evidence, Frame, Share, cm, turned_to

CANDIDATES = 6
"""Places of an answer that are far enough apart to be different answers, at most."""
WORTH = 0.05
"""Nats below which an object that was missed is not named; the score counts it all the same."""


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
                match.map, match.place, cm(match.position), storey, round(match.probability, 3),
                round(match.similarity, 3), kind,
            )  # fmt: skip
            if match.pose is not None:
                x, y, _ = cm(match.pose.position)
                made.pose = x, y, turned_to(match.pose.yaw)
                of = match.pose.covariance
                made.covariance = round(of[0], 4), round(of[1], 4), round(of[5], 4)
            if match is answer.matches[0] and answer.transform is not None:
                x, y, z = cm(answer.transform.translation)
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
    frame.seen = [(seen.object_ids[i], names[int(seen.classes[i])], cm(at[i].tolist())) for i in order]
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
    x, y, z = cm((moved.real, moved.imag, place[2] - origin[2]))
    candidate.laid = x, y, z, round(math.remainder(found.heading, 2 * math.pi), 4)
    if best.laid is None or best.pose is None:
        return
    back = np.exp(-1j * best.laid[3]) * (complex(*best.pose[:2]) - complex(*best.laid[:2]))
    x, y, _ = cm(((moved + turn * back).real, (moved + turn * back).imag, 0.0))
    heading = best.pose[2]
    turned = None if heading is None else math.remainder(heading - best.laid[3] + found.heading, 2 * math.pi)
    candidate.pose = x, y, turned_to(turned)


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
