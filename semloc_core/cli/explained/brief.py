"""In short: a line for each of what, where, how sure, because of what, unless what, and a few for why not there."""

from __future__ import annotations

from collections.abc import Sequence

from semloc_core.cli.explained.contrast import print_why_not
from semloc_core.cli.explained.lines import NAMED, head, place_of, print_what
from semloc_core.cli.explained.otherwise import would_change
from semloc_core.cli.shared.screen import point
from semloc_core.explain import LAYOUT
from semloc_core.text import summing
from semloc_core.wire import ClassAttribution, Explanation, MethodAttributions, PlaceMatches

OWN = ("attention", "closed_form")
"""What an encoder says of itself."""


def print_brief(
    matches: PlaceMatches, asked: str, reason: str, explanation: Explanation | None, other: Explanation | None = None
) -> None:
    """Print an answer and why it is that.

    Args:
        matches: the answer.
        asked: says what was asked about.
        reason: why there is no answer, or an empty string.
        explanation: of the answer; None where nothing was embedded.
        other: of another place of the map beside it; None where none was asked for.

    """
    best = print_what(matches, asked, reason, lambda best: f" at {point(best.position)}")
    if best is None:
        return
    meaning = "that this place is right" if matches.calibrated else "not calibrated"
    head("SURE", f"probability {best.probability:.3f} ({meaning}); {_rivals(matches)}")
    if explanation is None:
        return
    head("BECAUSE", "; ".join(_because(said) for said in _spoken(explanation.methods)) or "no object counted")
    head("UNLESS", would_change(explanation, matches))
    if other is not None:
        print_why_not(other, NAMED, best)


def _rivals(matches: PlaceMatches) -> str:
    if not matches.rivals:
        return "no rival elsewhere"
    named = [
        f"{of.rank}. {place_of(of.map, of.place)} at {point(of.position)} ({of.probability:.3f})"
        for of in matches.rivals[:NAMED]
    ]
    more = f" and {len(matches.rivals) - NAMED} more" if len(matches.rivals) > NAMED else ""
    return f"rivals: {'; '.join(named)}{more}"


def _spoken(methods: Sequence[MethodAttributions]) -> list[MethodAttributions]:
    """What decided, and attention beside it; else the most faithful."""
    order = sorted(methods, key=precedence)
    chosen = [said for said in order if said.classes and said.method in (LAYOUT, *OWN)]
    return chosen or [said for said in order if said.classes][:1]


def precedence(said: MethodAttributions) -> float:
    """What decided comes first; of what explains the similarity, the most faithful."""
    if said.method == LAYOUT:
        return -2.0
    return -said.fidelity.characterisation if said.fidelity else 1.0


def _because(said: MethodAttributions) -> str:
    if said.method != LAYOUT:
        return f"{said.method}: {shares_of(said.classes)}"
    parts = [(of.class_, of.score) for of in said.classes]
    if said.walls:
        parts.append(("walked where the map has no room", said.walls))
    total = sum(score for _, score in parts)
    return f"{total:.1f} nats (layout, which decided): {_parts(parts, 1, '+.1f', '')}"


def shares_of(classes: Sequence[ClassAttribution]) -> str:
    """Shares of the first classes, and of the rest; below zero: against. Their sizes add up to 100 %."""
    signs = {of.class_: -1.0 if of.score < 0 else 1.0 for of in classes}
    parts = [(of.class_, of.share) for of in classes]
    return _parts(parts, 2, ".0f", "%", signs)


def _parts(
    parts: Sequence[tuple[str, float]], digits: int, form: str, unit: str, signs: dict[str, float] | None = None
) -> str:
    """The largest parts of a sum, and the rest of it: what is printed adds up to the sum as it is printed."""
    scale = 100.0 if unit == "%" else 1.0
    order = sorted(parts, key=lambda of: -abs(of[1]))
    named = [of for of in order[:NAMED] if round(of[1], digits)]
    values, rest = [round(value, digits) for _, value in named], 0.0
    total = sum(value for _, value in parts)
    if len(named) == len(parts):
        values = summing([value for _, value in named], digits, total)
    else:
        rest = round(round(total, digits) - sum(values), digits)
    said = [
        f"{name} {(signs or {}).get(name, 1.0) * value * scale:{form}}{unit}"
        for (name, _), value in zip(named, values, strict=True)
    ]
    return ", ".join([*said, *([f"the rest {rest * scale:{form}}{unit}"] if rest else [])])
