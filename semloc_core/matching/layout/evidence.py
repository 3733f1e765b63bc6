"""What the test by layout rests on at one place of the map: each object seen, each object missed, each wall crossed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.expected_objects import expected_each
from semloc_core.matching.layout.pose.heading_vote import HEADINGS, STEP
from semloc_core.matching.layout.pose.local_map import Complex, There, around_rows
from semloc_core.matching.layout.verifier import LayoutVerifier, Verified
from semloc_core.text import short_repr

EXPLAINED = float(np.log(2.0))
"""Nats from which on an object is likelier a mapped one than invented."""


@short_repr
@dataclass(frozen=True, eq=False)
class Missed:
    """A mapped object that should have been seen, and was not.

    Args:
        id: of the object, in the building of the place.
        class_: its class, an index.
        lost: nats that it takes away, > 0.

    """

    id: str
    class_: int
    lost: float


@short_repr
@dataclass(frozen=True, eq=False)
class Evidence:
    """The score of one place, taken apart: a sum, so each part is exactly what it adds.

    Args:
        row: of the map.
        score: log-likelihood ratio (natural): the objects as mapped around there, against all invented.
        fragment: what was seen, n objects.
        explained: (n,) what each adds, ≥ 0: less what it would have cost not to see the object that explains it.
        mapped: for each the id of the mapped object that explains it best; None where it is likelier invented.
        missed: objects that should have been seen and explain nothing that was, the dearest first.
        walls: what known places take away where the map has no room, ≥ 0.
        heading: how the robot's frame is turned into the building's, were it there, radians.
        shift: (2,) metres from the map's place to where the robot's place is then.

    """

    row: int
    score: float
    fragment: Fragment
    explained: Floats
    mapped: tuple[str | None, ...]
    missed: tuple[Missed, ...]
    walls: float
    heading: float
    shift: Floats


def evidence(mapped: MappedLayout, fragment: Fragment, verified: Verified, row: int) -> Evidence | None:
    """Take the score of a place apart; None for a place that was not put to the test.

    Args:
        mapped: the map.
        fragment: what is around the robot.
        verified: the test.
        row: of the map.

    """
    found = np.flatnonzero(verified.rows == row)
    if not len(found):
        return None
    i = int(found[0])
    there = around_rows(mapped, verified.rows[i : i + 1])
    turn, shift = np.exp(1j * verified.heading[i : i + 1]), verified.shift[i : i + 1] @ np.array([1.0, 1j])
    lost = np.round(mapped.config.looked * expected_each(mapped, fragment, there, turn, shift), 9)
    explained = verified.explained[i].copy()
    partner = _partners(mapped, fragment, there, there.seen_from(turn, shift))
    partner[explained <= EXPLAINED] = -1
    cost, charged = dict(zip(there.objects.tolist(), lost.tolist(), strict=True)), set()
    for seen in np.argsort(-np.round(explained, 6), kind="stable").tolist():
        number = int(partner[seen])
        if number >= 0 and number not in charged:  # it was to be seen, and was: what it was to cost is this object's
            charged.add(number)
            explained[seen] -= cost[number]
    missed = [
        Missed(mapped.object_ids[number], int(class_), nats)
        for number, class_, nats in zip(there.objects.tolist(), there.classes.tolist(), lost.tolist(), strict=True)
        if nats > 0 and number not in charged
    ]
    return Evidence(
        row=row,
        score=float(verified.score[i]),
        fragment=fragment,
        explained=explained,
        mapped=tuple(mapped.object_ids[number] if number >= 0 else None for number in partner.tolist()),
        missed=tuple(sorted(missed, key=lambda of: (-of.lost, of.id))),
        walls=float(verified.walls[i]),
        heading=float(verified.heading[i]),
        shift=verified.shift[i],
    )


def evidence_at(verifier: LayoutVerifier, fragment: Fragment, row: int) -> Evidence:
    """The same of any place of the map, which is put to the test for it in all headings.

    Args:
        verifier: of the map.
        fragment: what is around the robot, an object at least.
        row: of the map.

    """
    headings = STEP * np.arange(HEADINGS, dtype=np.float64)
    tested = verifier.tested(fragment, np.full(HEADINGS, row, dtype=np.int64), headings)
    found = evidence(verifier.mapped, fragment, tested, row)
    assert found is not None
    return found


def _partners(mapped: MappedLayout, fragment: Fragment, there: There, where: Complex) -> Ints:
    """(n,) the mapped object that each seen one is likeliest to be; -1 where none of its classes is around."""
    partner = np.full(len(fragment.classes), -1, dtype=np.int64)
    if not len(where):
        return partner
    x, y, up = fragment.objects.T
    off = np.abs(np.subtract.outer(x + 1j * y, where)) / mapped.config.spread_m
    above = np.subtract.outer(up, there.up) / mapped.config.height_spread_m
    log_odds = np.log(np.maximum(mapped.odds[there.objects], np.finfo(np.float64).tiny))
    log_odds = log_odds - 0.5 * (off * off + above * above)
    if fragment.likely is None:
        log_odds[np.not_equal.outer(fragment.classes, there.classes)] = -np.inf
    else:
        with np.errstate(divide="ignore"):
            log_odds += np.log(mapped.weights(fragment.likely)[:, there.classes])
    best = np.round(log_odds, 6).argmax(axis=1)
    found = np.isfinite(log_odds[np.arange(len(best)), best])
    partner[found] = there.objects[best[found]]
    return partner
