"""``semloc explain``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import can_be_written, read_graph_or_run
from semloc_core.cli.shared.map_places import only_a_file
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import ConfigError, GraphError
from semloc_core.files import write_whole

if TYPE_CHECKING:
    from semloc_core.graph import SceneGraph


def explain(
    map_file: Annotated[Path, typer.Argument(metavar="MAP", parser=only_a_file, help="The map file.")],
    source: Annotated[Path, typer.Argument(metavar="GRAPH|RUN", help="What the robot knows.")],
    query: Annotated[
        str | None,
        typer.Option("--query", metavar="PLACE", help="The place to ask about; default: where a RUN ends."),
    ] = None,
    near: Annotated[
        str | None, typer.Option("--near", metavar="X,Y[,Z]", help="Ask about the place nearest to this point (m).")
    ] = None,
    within: Annotated[
        float, typer.Option("--within", metavar="METRES", min=0.0, help="How far from --near the place may be.")
    ] = MATCH_RADIUS_M,
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
    from semloc_core.cli.explained import print_answer, print_explanation
    from semloc_core.explain import asked_methods, check_asked, explain_pair, find_row
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import load

    chosen = None if methods is None else [name.strip() for name in methods.split(",")]
    check_asked(chosen or [])
    loaded = load(map_file)
    graph = read_graph_or_run(source, loaded.model.labelspace, of_map=True)
    query, said = _query_place(graph, query, near, within)
    localiser = Localiser(loaded)
    result = localiser.update(graph.to_update(seq=0, stamp_ns=0, frame_id="query", query_place=query))
    assert result.located is not None
    matches = result.located.matches
    asked = f"asked: place {query} at {_at(graph, query)} of {source.name}{said}"
    row = None
    if result.located.query.encoded is not None:  # what was asked wrongly is said before anything is printed
        row = find_row(result.located, building, place)
        chosen = asked_methods(result.located, row, chosen)
    elif place is not None:
        raise ConfigError(f"expected a query place that can be embedded (got {query}: {result.located.query.reason})")
    print_answer(matches, asked, result.located.query.reason)
    parts = [wire.encode(matches)] + ([wire.encode(result.attributions)] if result.attributions else [])
    if row is not None:
        explanation = explain_pair(result.located, row, methods=chosen)
        print_explanation(explanation, matches.matches[0].probability if matches.matches else None)
        parts.append(wire.encode(explanation))
    if json_file is not None:
        write_whole(json_file, b"[" + b",".join(parts) + b"]\n")


def _query_place(graph: SceneGraph, query: str | None, near: str | None, within: float) -> tuple[str, str]:
    """The place that the options mean, and words on where it is."""
    if near is not None:
        if query is not None:
            raise ConfigError("expected --query or --near (got both)")
        return _nearest(graph, near, within)
    said = ""
    if query is None:
        query, said = graph.query_place, ", the last that the robot was at"
        if query is None:
            raise ConfigError(
                "expected --query PLACE or --near X,Y (got neither, and the graph says no place of its own)"
            )
    if query not in graph.places:
        raise GraphError(
            f"expected --query to name one of the graph's {len(graph.places)} places, or --near X,Y (got {query})"
        )
    return query, said


def _nearest(graph: SceneGraph, near: str, within: float) -> tuple[str, str]:
    """The place nearest to a point, and how far it is."""
    try:
        point = [float(value) for value in near.split(",")]
    except ValueError:
        point = []
    if len(point) not in (2, 3) or not all(math.isfinite(value) for value in point):
        raise ConfigError(f"expected --near as X,Y or X,Y,Z in metres (got {near})")
    if not graph.places:
        raise GraphError("expected a graph with places (got none)")
    away = {id_: math.dist(at[: len(point)], point) for id_, at in graph.places.items()}
    place = min(away, key=lambda id_: (away[id_], id_))
    if away[place] > within:
        raise GraphError(
            f"expected a place within {within:g} m of --near {near} (got {away[place]:.1f} m to {place} at "
            f"{_at(graph, place)}; --within METRES allows more)"
        )
    return place, f", {away[place]:.2f} m from {near}"


def _at(graph: SceneGraph, place: str) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*graph.places[place])
