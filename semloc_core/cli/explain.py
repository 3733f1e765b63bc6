"""``semloc explain``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.common import can_be_written, console, read_graph_or_run
from semloc_core.errors import ConfigError, GraphError
from semloc_core.whole_file import write_whole

if TYPE_CHECKING:
    from semloc_core.evaluate.rows import Row
    from semloc_core.messages import Explanation, MethodAttributions, PlaceMatches
    from semloc_core.scene_graph import SceneGraph

CLASSES = 8
"""Classes printed at most; the JSON has all."""


def explain(
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="The map database.")],
    source: Annotated[Path, typer.Argument(metavar="GRAPH|RUN", help="What the robot knows.")],
    query: Annotated[
        str | None,
        typer.Option("--query", metavar="PLACE", help="The place to ask about; default: where a RUN ends."),
    ] = None,
    near: Annotated[
        str | None, typer.Option("--near", metavar="X,Y[,Z]", help="Ask about the place nearest to this point (m).")
    ] = None,
    place: Annotated[
        str | None, typer.Option("--place", metavar="PLACE", help="The map place to explain; default: the top match.")
    ] = None,
    building: Annotated[
        str | None, typer.Option("--map-name", metavar="BUILDING", help="The building of the map that --place is of.")
    ] = None,
    methods: Annotated[
        str | None, typer.Option("--methods", metavar="NAME,…", help="Explainers, by comma; default: all.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", callback=can_be_written, help="Write all messages as JSON.")
    ] = None,
) -> None:
    """Locate one place of a graph, and say which classes and objects made the match, or any other pair."""
    from semloc_core import wire
    from semloc_core.explain.pair import check_asked, explain_pair, find_row
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import load

    chosen = None if methods is None else [name.strip() for name in methods.split(",")]
    check_asked(chosen or [])
    loaded = load(map_file)
    graph = read_graph_or_run(source, loaded.model.labelspace)
    query = _query_place(graph, query, near)
    localiser = Localiser(loaded)
    result = localiser.update(graph.to_update(seq=0, stamp_ns=0, frame_id="query", query_place=query))
    assert result.located is not None
    matches = result.located.matches
    _print_matches(matches, query, result.located.query.reason)
    parts = [wire.encode(matches)] + ([wire.encode(result.attributions)] if result.attributions else [])
    if result.located.query.encoded is not None:
        row = find_row(result.located, building, place)
        explanation = explain_pair(result.located, row, methods=chosen)
        _print_explanation(explanation)
        parts.append(wire.encode(explanation))
    elif place is not None:
        raise ConfigError(f"expected a query place that can be embedded (got {query}: {result.located.query.reason})")
    if json_file is not None:
        write_whole(json_file, b"[" + b",".join(parts) + b"]\n")


def _query_place(graph: SceneGraph, query: str | None, near: str | None) -> str:
    """The place that the options mean."""
    if near is not None:
        if query is not None:
            raise ConfigError("expected --query or --near (got both)")
        try:
            point = [float(value) for value in near.split(",")]
        except ValueError:
            point = []
        if len(point) not in (2, 3) or not all(math.isfinite(value) for value in point):
            raise ConfigError(f"expected --near as X,Y or X,Y,Z in metres (got {near})")
        if not graph.places:
            raise GraphError("expected a graph with places (got none)")
        return min(graph.places, key=lambda id_: (math.dist(graph.places[id_][: len(point)], point), id_))
    if query is None:
        query = graph.query_place
        if query is None:
            raise ConfigError(
                "expected --query PLACE or --near X,Y (got neither, and the graph says no place of its own)"
            )
    if query not in graph.places:
        raise GraphError(
            f"expected --query to name one of the graph's {len(graph.places)} places, or --near X,Y (got {query})"
        )
    return query


def _print_matches(matches: PlaceMatches, query: str, reason: str) -> None:
    console.print(f"place {query}: {matches.status} {reason}".rstrip())
    for match in matches.matches:
        x, y, z = match.position
        console.print(
            f"  {match.rank:2d}. {match.map} {match.place} ({x:.2f}, {y:.2f}, {z:.2f}) "
            f"similarity {match.similarity:.4f}, probability {match.probability:.3f}"
        )


def _print_explanation(explanation: Explanation) -> None:
    console.print(f"why {explanation.match_map} {explanation.match_place} (similarity {explanation.similarity:.4f}):")
    _print_methods(explanation.methods)
    if explanation.why_not is not None:
        other = explanation.why_not
        console.print(
            f"why it is only number {other.rank}, behind {other.map} {other.place} (similarity {other.similarity:.4f}):"
        )
        if explanation.similarity is not None and explanation.similarity > other.similarity:
            console.print("  It is the more similar of the two: what put it behind is how the objects lie.")
        for contrast in other.classes:
            whom = "this place" if contrast.score > 0 else "the top match"
            console.print(f"    {contrast.score:+.4f}  {contrast.class_}: for {whom}")
    found = explanation.counterfactual
    if found is not None and found.removed:
        removed = _removed([(item.class_, item.id) for item in found.removed])
        console.print(
            f"by similarity alone, without {removed} the top match would be {found.map} {found.place} "
            f"(similarity {found.similarity:.4f})"
        )
    elif found is not None:
        console.print("no removal of objects that was tried changes the top match by similarity")


def _print_methods(methods: Sequence[MethodAttributions]) -> None:
    """A row an explainer, the most faithful first, and which one to read."""
    from semloc_core.evaluate.table import print_table

    order = sorted(methods, key=lambda said: -(said.fidelity.characterisation if said.fidelity else -1.0))
    if not order or not order[0].classes:
        return
    best = order[0]
    of_class = {of.class_: of.instances for of in best.classes}
    shown = [of.class_ for of in best.classes[:CLASSES]]
    rows: list[Row] = []
    for said in order:
        row: Row = {"method": said.method, "score": said.fidelity.characterisation if said.fidelity else None}
        share = {of.class_: math.copysign(of.share, of.score) for of in said.classes}
        rows.append(row | {f"{name} ({of_class[name]})": share[name] for name in shown})
    print_table(rows, title="shares of the classes by each explainer, the most faithful first", console=console)
    left_out = f" Of {len(best.classes)} classes the {CLASSES} largest." if len(best.classes) > CLASSES else ""
    console.print(f"  In brackets: how many objects. Below zero: speaks against this place.{left_out}")
    if best.fidelity is None:
        return
    others = ", ".join(f"{m.method} {m.fidelity.characterisation:.3f}" for m in order[1:] if m.fidelity is not None)
    console.print(
        f"  Read {best.method} first: put to the test it holds best, with a characterisation score of "
        f"{best.fidelity.characterisation:.3f}{f' ({others})' if others else ''}."
    )
    console.print(
        f"  Without the {best.fidelity.budget:.0%} of the objects that it puts first the similarity, on a scale from 0 "
        f"to 1, changes by {best.fidelity.necessity:.3f}; with them alone by {best.fidelity.sufficiency:.3f}."
    )
    if any(said.method == "layout" for said in order):
        console.print(
            "  layout: how the objects lie, which decided (needs no test: its parts are what was added up); "
            "the others: the similarity that proposed the place."
        )
    leaders = Counter(said.classes[0].class_ for said in order)
    leader, count = leaders.most_common(1)[0]
    console.print(f"  {count} of {len(order)} put {leader} first.")
    if any(said.method == "class_shapley" for said in order):
        console.print("  class_shapley is exact for classes, but tells no two objects of a class apart.")
    if unsigned := [said.method for said in order if said.method in ("attention", "saliency")]:
        console.print(f"  {' and '.join(unsigned)}: no sign; what counted, for this place or against it.")


def _removed(objects: list[tuple[str, str]]) -> str:
    """A few objects by name, many by number of each class."""
    if len(objects) <= 3:
        return ", ".join(f"{class_} {id_}" for class_, id_ in objects)
    counts = Counter(class_ for class_, _ in objects)
    return ", ".join(f"{count} × {class_}" for class_, count in sorted(counts.items()))
