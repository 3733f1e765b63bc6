"""Why another place is not the answer: by what decides, object by object; by similarity, where all is told."""

from __future__ import annotations

import math

from semloc_core.cli.explained.lines import head, line, place_of
from semloc_core.cli.shared.screen import many, point
from semloc_core.graph import short_id
from semloc_core.wire import Explanation, Match, ObjectAttribution, PlaceEvidence

LEAST = 0.05
"""Nats; what differs by less is not named."""


def print_why_not(explanation: Explanation, most: int | None, answer: Match | None = None) -> None:
    """Print why the explained place is not the answer.

    Args:
        explanation: of a place that is not the top match.
        answer: the top match, from which the place is so far.
        most: lines of objects at most; None: all that differ, and the contrast by similarity.

    """
    other = explanation.why_not
    if other is None:
        head("WHY NOT", "it is the answer")
        return
    top, here = place_of(other.map, other.place), place_of(explanation.match_map, explanation.match_place)
    if explanation.position is not None:
        here += f" at {point(explanation.position)}"
    if explanation.position is not None and answer is not None and answer.map == explanation.match_map:
        here += f", {math.dist(explanation.position, answer.position):.1f} m from the answer"
    if explanation.probability is not None:
        here += f", probability {explanation.probability:.3f}"
    if other.evidence is not None:
        this, best = other.evidence
        head("WHY NOT", f"{here}: {this.score:.1f} nats, against {best.score:.1f} of {top}")
        lines = _contrasts(this, best)
        for _, text in lines[:most]:
            line(text)
        shown = sum(value for value, _ in lines[:most])
        rest = _tenths(this.score) - _tenths(best.score) - shown
        hidden = 0 if most is None else max(len(lines) - most, 0)
        if hidden:
            line(f"and {many(hidden, 'smaller difference')}, {rest / 10:+.1f} together (--long)")
        elif rest:
            line(f"and what differs by less, or is lost in rounding, {rest / 10:+.1f} together")
        if most is not None:
            return
        line(f"by the answer's order it is number {other.rank}; by similarity:")
    else:
        head("WHY NOT", f"{here}: number {other.rank}, behind {top}")
    line(f"similarity {explanation.similarity or 0.0:.4f} here, {other.similarity:.4f} there")
    for contrast in other.classes[:most]:
        line(f"{contrast.score:+.4f}  {contrast.class_}: for {'this place' if contrast.score > 0 else 'the top match'}")


def _contrasts(this: PlaceEvidence, best: PlaceEvidence) -> list[tuple[int, str]]:
    """What speaks otherwise at two places: by how many tenths of a nat, as printed, and a line; the largest first."""
    found: list[tuple[float, int, str]] = []
    here, there = (f"at {short_id(each.place)}" for each in (this, best))
    if here == there:  # of two buildings
        here, there = f"{here} of {this.map}", f"{there} of {best.map}"

    def add(one: float, other: float, text: str) -> None:
        if abs(one - other) >= LEAST:
            found.append((one - other, _tenths(one) - _tenths(other), text))

    beside = {of.id: of for of in best.objects}
    for of in this.objects:
        other = beside[of.id]
        sides = f"{of.score:+.1f} {here}{_as(of.mapped)}, {other.score:+.1f} {there}{_as(other.mapped)}"
        add(of.score, other.score, f"saw {of.class_} {short_id(of.id)}: {sides}")
    missed = {of.id: of for of in best.missed} if this.map == best.map else {}
    for of in this.missed:
        also = missed.pop(of.id, None)
        add(of.score, also.score if also else 0.0, _missed(of, here, also, there))
    for of in missed.values() if this.map == best.map else best.missed:
        add(0.0, of.score, _missed(of, there, None, here))
    sides = f"{this.walls:+.1f} {here}, {best.walls:+.1f} {there}"
    add(this.walls, best.walls, f"walked where the map has no room: {sides}")
    return [(tenths, text) for _, tenths, text in sorted(found, key=lambda of: (-abs(round(of[0], 6)), of[2]))]


def _missed(of: ObjectAttribution, here: str, also: ObjectAttribution | None, there: str) -> str:
    """An object that should have been seen here, or at both places."""
    seen = f"did not see {of.class_} {short_id(of.id)}, mapped"
    if also is None:
        return f"{seen} {here}: {of.score:+.1f}"
    return f"{seen} near both: {of.score:+.1f} {here}, {also.score:+.1f} {there}"


def _tenths(nats: float) -> int:
    """As it is printed."""
    return round(float(f"{nats:.1f}") * 10)


def _as(mapped: str | None) -> str:
    return f" (as {short_id(mapped)})" if mapped is not None else ""
