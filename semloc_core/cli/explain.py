"""``semloc explain``."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.common import console, read_graph_or_run
from semloc_core.errors import ConfigError, GraphError

if TYPE_CHECKING:
    from semloc_core.messages import Explanation, PlaceMatches
    from semloc_core.scene_graph import SceneGraph


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
        Path | None, typer.Option("--json", metavar="FILE", help="Write all messages as JSON.")
    ] = None,
) -> None:
    """Locate one place of a graph, and say which classes and objects made the match, or any other pair."""
    from semloc_core import wire
    from semloc_core.explain.explainers import check_methods
    from semloc_core.explain.pair import explain_pair, find_row
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import load

    chosen = None if methods is None else [name.strip() for name in methods.split(",")]
    check_methods(chosen or [])
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
        row = find_row(loaded, result.located.query, building, place)
        explanation = explain_pair(loaded, result.located.query, row, methods=chosen)
        _print_explanation(explanation)
        parts.append(wire.encode(explanation))
    elif place is not None:
        raise ConfigError(f"expected a query place that can be embedded (got {query}: {result.located.query.reason})")
    if json_file is not None:
        json_file.write_bytes(b"[" + b",".join(parts) + b"]\n")


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
    for said in explanation.methods:
        console.print(f"  {said.method}")
        for row in said.classes:
            console.print(f"    {row.share:6.1%}  {row.class_} ({row.instances}), score {row.score:+.4f}")
        if said.fidelity is not None:
            console.print(
                f"    on the top {said.fidelity.budget:.0%} of its objects: necessity {said.fidelity.necessity:.4f}, "
                f"sufficiency {said.fidelity.sufficiency:.4f}, characterisation {said.fidelity.characterisation:.4f}"
            )
    if explanation.why_not is not None:
        other = explanation.why_not
        console.print(
            f"why it is only number {other.rank}, behind {other.map} {other.place} (similarity {other.similarity:.4f}):"
        )
        for contrast in other.classes:
            whom = "this place" if contrast.score > 0 else "the top match"
            console.print(f"    {contrast.score:+.4f}  {contrast.class_}: for {whom}")
    found = explanation.counterfactual
    if found is not None and found.removed:
        removed = _removed([(item.class_, item.id) for item in found.removed])
        console.print(
            f"without {removed} the top match would be {found.map} {found.place} (similarity {found.similarity:.4f})"
        )
    elif found is not None:
        console.print("no removal of objects that was tried changes the top match")


def _removed(objects: list[tuple[str, str]]) -> str:
    """A few objects by name, many by number of each class."""
    if len(objects) <= 3:
        return ", ".join(f"{class_} {id_}" for class_, id_ in objects)
    counts = Counter(class_ for class_, _ in objects)
    return ", ".join(f"{count} × {class_}" for class_, count in sorted(counts.items()))
