"""What ``semloc explain`` prints: what the answer is, where, why, and what if things were otherwise."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence

from rich.table import Table
from rich.text import Text

from semloc_core.cli.shared.screen import console, cut, plain_table, point, print_whole
from semloc_core.explain import LAYOUT
from semloc_core.graph import short_id
from semloc_core.text import percent
from semloc_core.wire import (
    ClassAttribution,
    Counterfactual,
    Explanation,
    Match,
    MethodAttributions,
    PlaceEvidence,
    PlaceMatches,
    WhyNot,
    WithoutClass,
)

NAMED = 4
"""Classes, objects and rivals named in a line at most; ``--long`` names more."""
CLASSES = 8
"""Classes printed at most; the JSON has all."""
REMOVED_CLASSES = 6
"""Classes of removed objects that are named."""
SAME_PROBABILITY = 0.005
"""A probability nearer than this to the published one is no other answer."""
OWN = ("attention", "closed_form")
"""What an encoder says of itself."""
UNSIGNED = ("attention", "saliency")


def head(word: str, rest: str) -> None:
    """The first line of a part."""
    console.print(Text.assemble((f"{word:8s}", "bold"), f" {rest}"))


def line(text: str) -> None:
    """A further line of a part."""
    console.print(f"{'':8s} {text}")


def print_brief(matches: PlaceMatches, asked: str, reason: str, explanation: Explanation | None) -> None:
    """What, where, how sure, why, and what would change it: a line each; why not, where another place was asked for.

    Args:
        matches: the answer.
        asked: says what was asked about.
        reason: why there is no answer, or an empty string.
        explanation: of the answer, or of another place of the map beside it; None where nothing was embedded.

    """
    best = _print_what(matches, asked, reason, lambda best: f" at {point(best.position)}")
    if best is None:
        return
    meaning = "that this place is right" if matches.calibrated else "not calibrated"
    head("SURE", f"probability {best.probability:.3f} ({meaning}); {_rivals(matches)}")
    if explanation is None:
        return
    order = sorted(explanation.methods, key=_precedence)
    other = explanation.why_not
    if other is not None and other.evidence is not None:  # the explainers speak of the place asked for
        head("BECAUSE", f"{_nats(_of_classes(other.evidence[1]))} nats (layout, which decided)")
    elif other is None:
        head("BECAUSE", "; ".join(_because(said) for said in _spoken(order)) or "no object counted")
    if explanation.why_not is not None:
        _print_why_not(explanation.why_not, explanation, NAMED)
    else:
        head("UNLESS", _would_change(explanation, best.probability))


def _print_what(matches: PlaceMatches, asked: str, reason: str, more: Callable[[Match], str]) -> Match | None:
    """What and where: the best place, and ``more`` of it; None where there is none."""
    best = matches.matches[0] if matches.matches else None
    if best is None:
        head("WHAT", f"{matches.status}: {reason or 'no place of the map'}")
    else:
        place = f"{best.map}, place {short_id(best.place)}{more(best)}"
        head("WHAT", f"{matches.status}: {place}{f'; {reason}' if reason else ''}")
    head("WHERE", asked)
    return best


def _rivals(matches: PlaceMatches) -> str:
    if not matches.rivals:
        return "no rival elsewhere"
    named = [f"{of.map}, place {short_id(of.place)} ({of.probability:.3f})" for of in matches.rivals[:NAMED]]
    more = f" and {len(matches.rivals) - NAMED} more" if len(matches.rivals) > NAMED else ""
    return f"rivals: {'; '.join(named)}{more}"


def _spoken(order: Sequence[MethodAttributions]) -> list[MethodAttributions]:
    """What decided, and attention beside it; else the most faithful."""
    chosen = [said for said in order if said.classes and said.method in (LAYOUT, *OWN)]
    return chosen or [said for said in order if said.classes][:1]


def _because(said: MethodAttributions) -> str:
    if said.method != LAYOUT:
        return f"{said.method}: {_shares(said.classes)}"
    return f"{_nats([(of.class_, of.score) for of in said.classes])} nats (layout, which decided)"


def _nats(classes: Sequence[tuple[str, float]]) -> str:
    return ", ".join(f"{name} {score:+.1f}" for name, score in classes[:NAMED])


def _of_classes(evidence: PlaceEvidence) -> list[tuple[str, float]]:
    """Class -> what its objects, seen and missed, add at a place; the largest first."""
    total: dict[str, float] = {}
    for of in (*evidence.objects, *evidence.missed):
        total[of.class_] = total.get(of.class_, 0.0) + of.score
    return sorted(total.items(), key=lambda item: (-abs(item[1]), item[0]))


def _shares(classes: Sequence[ClassAttribution]) -> str:
    return ", ".join(f"{of.class_} {percent(math.copysign(of.share, of.score))}" for of in classes[:NAMED])


def _would_change(explanation: Explanation, published: float) -> str:
    """The classes without which the answer would be another, or the probability."""
    changing = [of for of in explanation.without or [] if not _changes_nothing(of, published)]
    if changing:
        return "; ".join(_without([of]) for of in changing[:NAMED])
    if explanation.without:
        return f"no single class: without any one of {len(explanation.without)} the answer is the same"
    found = explanation.counterfactual
    if found is not None and found.removed:
        return (
            f"without {_removed([(of.class_, of.id) for of in found.removed])}: {found.map}, place {_of(found.place)}"
        )
    return "no removal that was tried changes it"


def _of(place: str | None) -> str:
    return short_id(place) if place is not None else "–"


def print_answer(matches: PlaceMatches, asked: str, reason: str) -> None:
    """What and where: the best place, the place that was asked about, and all places of the answer."""
    unsure = "" if matches.calibrated else " (not calibrated)"
    if _print_what(matches, asked, reason, lambda best: f", probability {best.probability:.3f}{unsure}") is None:
        return
    table = _columns(("rank", "right"), ("building", "left"), ("place", "left"), ("at (m)", "left"))
    for name in ("similarity", "probability"):
        table.add_column(name, justify="right")
    for match in matches.matches:
        figures = (f"{match.similarity:.4f}", f"{match.probability:.3f}")
        table.add_row("", str(match.rank), cut(match.map), short_id(match.place), point(match.position), *figures)
    print_whole(table, console)


def print_explanation(explanation: Explanation, published: float | None = None) -> None:
    """Why: the classes by each explainer; why not the top match; and what if objects were not there.

    Args:
        explanation: of a query and a place.
        published: the answer's probability: classes that change neither it nor the place share a line; None: a line
            a class.

    """
    of = f"{explanation.match_map}, place {_of(explanation.match_place)} (similarity {explanation.similarity:.4f})"
    # What decided comes first; of what explains the similarity, the most faithful.
    order = sorted(explanation.methods, key=_precedence)
    if order and order[0].classes:
        _print_methods(order, of)
    else:
        head("WHY", f"{of}: no object counted")
    if explanation.why_not is not None:
        _print_why_not(explanation.why_not, explanation, None)
    _print_what_if(order, explanation.counterfactual, explanation.without or [], published)


def _print_methods(order: Sequence[MethodAttributions], of: str) -> None:
    best = order[0]
    head("WHY", f"{_shares(best.classes)}: so says {best.method}, {_rank_of(order)}")
    line(of)
    table = _columns(("class", "left"), ("objects", "right"))
    for said in order:
        table.add_column(said.method.replace("_", "\n"), justify="right")
    shares = [{of.class_: math.copysign(of.share, of.score) for of in said.classes} for said in order]
    for found in best.classes[:CLASSES]:
        cells = [percent(share[found.class_], 1) if found.class_ in share else "–" for share in shares]
        table.add_row("", found.class_, str(found.instances), *cells)
    if any(said.fidelity is not None for said in order):
        held = [f"{said.fidelity.characterisation:.3f}" if said.fidelity else "–" for said in order]
        table.add_section()
        table.add_row("", "faithful", "", *held)
    print_whole(table, console)
    if len(best.classes) > CLASSES:
        line(f"of {len(best.classes)} classes the {CLASSES} largest")
    line("share of each class; below zero: speaks against this place")
    if any(said.fidelity is not None for said in order):
        line("faithful: characterisation score, what an explainer holds when put to the test (0 to 1)")
    if len(order) > 1:
        _print_leader(order)
    if unsigned := [said.method for said in order if said.method in UNSIGNED]:
        line(f"{' and '.join(unsigned)}: no sign; what counted, for this place or against it")
    if any(said.method == "class_shapley" for said in order):
        line("class_shapley: exact for classes, but tells no two objects of a class apart")
    if any(said.method == LAYOUT for said in order):
        line("layout: what each class adds to the test that decided, exactly; the others explain the similarity")


def _print_leader(order: Sequence[MethodAttributions]) -> None:
    leader, count = Counter(said.classes[0].class_ for said in order if said.classes).most_common(1)[0]
    line(f"{count} of {len(order)} put {leader} first")


def _precedence(said: MethodAttributions) -> float:
    if said.method == LAYOUT:
        return -2.0
    return -said.fidelity.characterisation if said.fidelity else 1.0


def _rank_of(order: Sequence[MethodAttributions]) -> str:
    if order[0].method == LAYOUT:
        return "the test that decided"
    if len(order) == 1:
        return "the only explainer asked"
    return f"the most faithful of {len(order)} explainers" if order[0].fidelity else f"first of {len(order)} explainers"


def _print_why_not(other: WhyNot, explanation: Explanation, most: int | None) -> None:
    """Why the place asked for is not the answer: by what decides, object by object; then by similarity, if all is told.

    Args:
        other: the contrast.
        explanation: that it is of.
        most: lines of objects at most; None: all that differ, and the contrast by similarity.

    """
    top = f"{other.map}, place {short_id(other.place)}"
    here = f"{explanation.match_map}, place {_of(explanation.match_place)}"
    if other.evidence is not None:
        this, best = other.evidence
        head("WHY NOT", f"{here}: {this.score:.1f} nats, against {best.score:.1f} of {top}")
        lines = _contrasts(this, best)
        for text in lines[:most]:
            line(text)
        if most is not None and len(lines) > most:
            line(f"and {len(lines) - most} smaller differences (--long)")
        if most is not None:
            return
        line(f"by the answer's order it is number {other.rank}; by similarity:")
    else:
        head("WHY NOT", f"{here} is number {other.rank}, behind {top}")
    line(f"similarity {explanation.similarity or 0.0:.4f} here, {other.similarity:.4f} there")
    for contrast in other.classes[:most]:
        line(f"{contrast.score:+.4f}  {contrast.class_}: for {'this place' if contrast.score > 0 else 'the top match'}")


def _contrasts(this: PlaceEvidence, best: PlaceEvidence) -> list[str]:
    """A line for each object that speaks otherwise at two places, those that differ most first."""
    found: list[tuple[float, str]] = []
    beside = {of.id: of for of in best.objects}
    here, there = (f"at {short_id(each.place)}" for each in (this, best))
    if here == there:  # of two buildings
        here, there = f"{here} of {this.map}", f"{there} of {best.map}"
    for of in this.objects:
        other = beside[of.id]
        sides = f"{of.score:+.1f} {here}{_as(of.mapped)}, {other.score:+.1f} {there}{_as(other.mapped)}"
        found.append((of.score - other.score, f"saw {of.class_} {short_id(of.id)}: {sides}"))
    for side, evidence, sign in ((here, this, 1.0), (there, best, -1.0)):
        for of in evidence.missed:
            text = f"did not see {of.class_} {short_id(of.id)}, mapped {side}: {of.score:+.1f}"
            found.append((sign * of.score, text))
    walls = f"walked where the map has no room: {this.walls:+.1f} {here}, {best.walls:+.1f} {there}"
    found.append((this.walls - best.walls, walls))
    found = [(value, text) for value, text in found if abs(value) >= 0.05]
    return [text for _, text in sorted(found, key=lambda of: (-abs(round(of[0], 6)), of[1]))]


def _as(mapped: str | None) -> str:
    return f" (as {short_id(mapped)})" if mapped is not None else ""


def _print_what_if(
    order: Sequence[MethodAttributions],
    found: Counterfactual | None,
    without: Sequence[WithoutClass],
    published: float | None,
) -> None:
    idle = [of for of in without if _changes_nothing(of, published)]
    said = [_without([of]) for of in without if of not in idle] + ([_without(idle)] if idle else [])
    tested = [one for one in order if one.fidelity is not None and one.classes][:1]
    if tested and (fidelity := tested[0].fidelity) is not None:
        put = f"the {percent(fidelity.budget)} of the objects that {tested[0].method} puts first"
        said.append(f"without {put}")
        said.append(f"  the similarity, on a scale from 0 to 1, changes by {fidelity.necessity:.3f}")
        said.append(f"with them alone, by {fidelity.sufficiency:.3f}")
    if found is not None and found.removed:
        said.append(f"without {_removed([(item.class_, item.id) for item in found.removed])}")
        said.append(
            f"  the top match by similarity alone is {found.map}, place {_of(found.place)} ({found.similarity:.4f})"
        )
    elif found is not None:
        said.append("no removal of objects that was tried changes the top match by similarity")
    for number, text in enumerate(said):
        (line if number else lambda words: head("WHAT IF", words))(text)


def _changes_nothing(found: WithoutClass, published: float | None) -> bool:
    if published is None:
        return False
    return found.same and abs(found.probability - published) <= SAME_PROBABILITY


def _without(alike: Sequence[WithoutClass]) -> str:
    """The answer without a class, by similarity and layout; or without any one of several that change nothing."""
    found = alike[0]
    seen = f"had it seen {', or '.join(f'no {of.class_}' for of in alike)}"
    if found.map is None:
        return f"{seen}: nothing to go by"
    there = "the same answer" if found.same else f"{found.map}, place {_of(found.place)}"
    values = sorted(f"{of.probability:.3f}" for of in alike)
    return f"{seen}: {there}, probability {' to '.join(dict.fromkeys((values[0], values[-1])))}"


def _columns(*names: tuple[str, str]) -> Table:
    """A table without a frame, as far to the right as the lines of a part."""
    table = plain_table("dim")
    table.add_column("", width=7)
    for name, justify in names:
        table.add_column(name, justify="right" if justify == "right" else "left")
    return table


def _removed(objects: list[tuple[str, str]]) -> str:
    """A few objects by name, many by number of each class, the most first."""
    if len(objects) <= 3:
        return ", ".join(f"{class_} {short_id(id_)}" for class_, id_ in objects)
    counts = Counter(class_ for class_, _ in objects)
    most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{count} × {class_}" for class_, count in most[:REMOVED_CLASSES])
    more = len(most) - REMOVED_CLASSES
    return f"{named} and {more} more" if more > 0 else named
