"""With ``--long``: every place of an answer, every explainer, object by object."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from rich.table import Table

from semloc_core.cli.explained.brief import precedence, shares_of
from semloc_core.cli.explained.contrast import print_why_not
from semloc_core.cli.explained.lines import head, line, place_of, print_what
from semloc_core.cli.explained.otherwise import print_what_if
from semloc_core.cli.shared.screen import console, cut, plain_table, point, print_whole
from semloc_core.explain import LAYOUT
from semloc_core.graph import short_id
from semloc_core.text import percent
from semloc_core.wire import Explanation, MethodAttributions, PlaceMatches, WithoutClass

CLASSES = 8
"""Classes printed at most; the JSON has all."""
UNSIGNED = ("attention", "saliency")


def print_answer(matches: PlaceMatches, asked: str, reason: str) -> None:
    """What and where: the best place, the place that was asked about, and all places of the answer."""
    unsure = "" if matches.calibrated else " (not calibrated)"
    if print_what(matches, asked, reason, lambda best: f", probability {best.probability:.3f}{unsure}") is None:
        return
    table = _columns(("rank", "right"), ("building", "left"), ("place", "left"), ("at (m)", "left"))
    for name in ("similarity", "probability"):
        table.add_column(name, justify="right")
    for match in matches.matches:
        figures = (f"{match.similarity:.4f}", f"{match.probability:.3f}")
        table.add_row("", str(match.rank), cut(match.map), short_id(match.place), point(match.position), *figures)
    print_whole(table, console)


def print_explanation(
    explanation: Explanation,
    published: PlaceMatches | None = None,
    without: Sequence[WithoutClass] | None = None,
) -> None:
    """Why: the classes by each explainer; why not the top match; and what if objects were not there.

    Args:
        explanation: of a query and a place.
        published: the answer: classes that change nothing of it share a line; None: a line a class.
        without: what the answer would be without a class, where the explanation is of another place.

    """
    position = "" if explanation.position is None else f" at {point(explanation.position)}"
    of = f"{place_of(explanation.match_map, explanation.match_place)}{position}"
    of += f" (similarity {explanation.similarity:.4f})"
    order = sorted(explanation.methods, key=precedence)
    if order and order[0].classes:
        _print_methods(order, of)
    else:
        head("WHY", f"{of}: no object counted")
    if explanation.why_not is not None:
        print_why_not(explanation, None, published.matches[0] if published is not None else None)
    print_what_if(order, explanation.counterfactual, explanation.without or without or [], published)


def _print_methods(order: Sequence[MethodAttributions], of: str) -> None:
    best = order[0]
    head("WHY", f"{shares_of(best.classes)}: so says {best.method}, {_rank_of(order)}")
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


def _rank_of(order: Sequence[MethodAttributions]) -> str:
    if order[0].method == LAYOUT:
        return "the test that decided"
    if len(order) == 1:
        return "the only explainer asked"
    return f"the most faithful of {len(order)} explainers" if order[0].fidelity else f"first of {len(order)} explainers"


def _columns(*names: tuple[str, str]) -> Table:
    """A table without a frame, as far to the right as the lines of a part."""
    table = plain_table("dim")
    table.add_column("", width=7)
    for name, justify in names:
        table.add_column(name, justify="right" if justify == "right" else "left")
    return table
