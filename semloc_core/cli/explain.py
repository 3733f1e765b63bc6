"""``semloc explain``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.common import console, read_graph_or_run
from semloc_core.errors import GraphError


def explain(
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="The map database.")],
    source: Annotated[Path, typer.Argument(metavar="GRAPH|RUN", help="What the robot knows.")],
    query: Annotated[str, typer.Option("--query", metavar="PLACE", help="The place to ask about.")],
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write both messages as JSON.")
    ] = None,
) -> None:
    """Locate one place of a graph, and say which classes and objects made the match."""
    from semloc_core import wire
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import load

    loaded = load(map_file)
    graph = read_graph_or_run(source, loaded.model.labelspace)
    if query not in graph.places:
        raise GraphError(f"expected --query to name one of the graph's {len(graph.places)} places (got {query})")
    localiser = Localiser(loaded)
    result = localiser.update(graph.to_update(seq=0, stamp_ns=0, frame_id="query", query_place=query))
    assert result.located is not None
    matches = result.located.matches
    console.print(f"place {query}: {matches.status} {result.located.query.reason}".rstrip())
    for match in matches.matches:
        x, y, z = match.position
        console.print(
            f"  {match.rank:2d}. {match.map} {match.place} ({x:.2f}, {y:.2f}, {z:.2f}) "
            f"similarity {match.similarity:.4f}, probability {match.probability:.3f}"
        )
    if result.attributions is not None:
        console.print(f"because ({result.attributions.method}):")
        for row in result.attributions.classes:
            console.print(f"  {row.share:6.1%}  {row.class_} ({row.instances})")
    if json_file is not None:
        parts = [wire.encode(matches)] + ([wire.encode(result.attributions)] if result.attributions else [])
        json_file.write_bytes(b"[" + b",".join(parts) + b"]\n")
