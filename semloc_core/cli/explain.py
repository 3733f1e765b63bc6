"""``semloc explain``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from semloc_core.cli.shared.common import (
    LabelspaceOption,
    MethodsOption,
    RobotOption,
    SynonymsOption,
    TopicOption,
    by_comma,
    read_graph_or_run,
)
from semloc_core.cli.shared.foreign_classes import report_unknown_classes
from semloc_core.cli.shared.map_places import only_a_file
from semloc_core.cli.shared.outputs import Writes
from semloc_core.cli.shared.screen import point
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import ConfigError, GraphError
from semloc_core.files import MESSAGES, write_whole
from semloc_core.graph import full_id, short_id

if TYPE_CHECKING:
    from semloc_core.graph import SceneGraph
    from semloc_core.map_database import LoadedMap
    from semloc_core.matching import Located

NO_RIVALS = (
    "expected an answer with rivals (got none: no other place is nearly as likely; --place-near X,Y or --place PLACE "
    "names one)"
)


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
        float,
        typer.Option("--within", metavar="METRES", min=0.0, help="How far from --near or --place-near a place may be."),
    ] = MATCH_RADIUS_M,
    place: Annotated[
        str | None, typer.Option("--place", metavar="PLACE", help="The map place to explain; default: the top match.")
    ] = None,
    building: Annotated[
        str | None, typer.Option("--map-name", metavar="BUILDING", help="The building of the map that --place is of.")
    ] = None,
    place_near: Annotated[
        str | None,
        typer.Option("--place-near", metavar="X,Y[,Z]", help="Explain the map place nearest to this point (m)."),
    ] = None,
    rival: Annotated[
        int | None, typer.Option("--rival", metavar="K", min=1, help="Explain the answer's K-th rival: why not there?")
    ] = None,
    methods: MethodsOption = None,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    topic: TopicOption = None,
    robot: RobotOption = None,
    long: Annotated[
        bool, typer.Option("--long", help="All of it: every place listed, every explainer, object by object.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", parser=Writes(MESSAGES), help="Write all messages as JSON.")
    ] = None,
) -> None:
    """Locate one place of a graph; say what decided, and why not any other place of the map.

    Ids are printed as p86 or O12 where they are Hydra's, and are taken so, or whole.
    """
    from semloc_core import wire
    from semloc_core.cli.explained import print_answer, print_brief, print_explanation
    from semloc_core.explain import asked_methods, check_asked, explain_pair
    from semloc_core.graph import advice, all_unknown, count_unknown
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import load, reading_for

    chosen = None if methods is None else by_comma(methods)
    check_asked(chosen or [])
    if near is not None and query is not None:
        raise ConfigError("expected --query or --near (got both)")
    elsewhere = sum(option is not None for option in (place, place_near, rival))
    if elsewhere > 1:
        raise ConfigError("expected one of --place, --place-near and --rival (got more)")
    at = None if near is None else _Point.of("--near", near)
    place_at = None if place_near is None else _Point.of("--place-near", place_near)
    loaded = load(map_file)
    if place_at is not None and (building is not None or len(loaded.buildings) == 1):
        _nearest_mapped(loaded, building or loaded.buildings[0], place_at, within)  # or refuse before the long work
    graph = read_graph_or_run(source, reading_for(loaded, labelspace, synonyms, topic, robot))
    unknown = count_unknown(graph, loaded.model.labelspace)
    nothing = all_unknown((thing.class_ for thing in graph.objects.values()), loaded.model.labelspace)
    report_unknown_classes(unknown, str(source), advise=not nothing)
    query, said = _query_place(graph, query, at, within)
    localiser = Localiser(loaded)
    result = localiser.update(graph.to_update(seq=0, stamp_ns=0, frame_id="query", query_place=query))
    assert result.located is not None
    matches = result.located.matches
    asked = f"asked: place {short_id(query)} at {point(graph.places[query])} of {source.name}{said}"
    explanation, other = None, None
    if result.located.query.encoded is not None:  # what was asked wrongly is said before anything is printed
        row = _map_row(result.located, building, place, place_at, rival, within)
        chosen = asked_methods(result.located, chosen)
        assert result.located.best_row is not None
        explanation = explain_pair(result.located, result.located.best_row, methods=chosen)
        if row != result.located.best_row:
            other = explain_pair(result.located, row, methods=chosen)
        elif elsewhere:
            other = explanation
    elif elsewhere:
        raise ConfigError(f"expected a query place that can be embedded (got {query}: {result.located.query.reason})")
    reason = result.located.query.reason
    if nothing and unknown:
        reason = f"{nothing}; {advice(unknown)}"
    if long:
        print_answer(matches, asked, reason)
        if explanation is not None:
            print_explanation(other or explanation, matches, explanation.without)
    else:
        print_brief(matches, asked, reason, explanation, other)
    said_of = (matches, result.evidence, result.attributions, explanation, None if other is explanation else other)
    parts = [wire.encode(message) for message in said_of if message is not None]
    if json_file is not None:
        write_whole(json_file, b"[" + b",".join(parts) + b"]\n")


def _map_row(
    located: Located, building: str | None, place: str | None, near: _Point | None, rival: int | None, within: float
) -> int:
    """The row of the map place that the options mean."""
    from semloc_core.explain import find_row

    loaded = located.map
    if rival is not None:
        rivals = located.matches.rivals
        if rival > len(rivals):
            raise ConfigError(f"expected --rival 1 to {len(rivals)} (got {rival})" if rivals else NO_RIVALS)
        return loaded.row(rivals[rival - 1].map, rivals[rival - 1].place)
    if near is not None:
        building = building or located.matches.matches[0].map
        return loaded.row(building, _nearest_mapped(loaded, building, near, within))
    return find_row(located, building, None if place is None else full_id(place, set(loaded.place_ids)))


def _nearest_mapped(loaded: LoadedMap, building: str, near: _Point, within: float) -> str:
    """The place of a building of the map that is nearest to a point."""
    of = loaded.rows_of(building)
    places = {loaded.place_ids[row]: tuple(loaded.positions[row].tolist()) for row in range(of.start, of.stop)}
    return _nearest(places, near, within)[0]


def _query_place(graph: SceneGraph, query: str | None, near: _Point | None, within: float) -> tuple[str, str]:
    """The place that the options mean, and words on where it is."""
    if near is not None:
        return _nearest(graph.places, near, within)
    said = ""
    if query is None:
        query, said = graph.query_place, ", the last that the robot was at"
        if query is None:
            raise ConfigError(
                "expected --query PLACE or --near X,Y (got neither, and the graph says no place of its own)"
            )
    query = full_id(query, graph.places)
    if query not in graph.places:
        raise GraphError(
            f"expected --query to name one of the graph's {len(graph.places)} places, or --near X,Y (got {query})"
        )
    return query, said


class _Point(NamedTuple):
    """A point as an option gives it: two or three metres, and the words."""

    option: str
    said: str
    metres: list[float]

    @classmethod
    def of(cls, option: str, said: str) -> _Point:
        """Read it; ConfigError where it is none."""
        try:
            metres = [float(value) for value in said.split(",")]
        except ValueError:
            metres = []
        if len(metres) not in (2, 3) or not all(math.isfinite(value) for value in metres):
            raise ConfigError(f"expected {option} as X,Y or X,Y,Z in metres (got {said})")
        return cls(option, said, metres)


def _nearest(places: Mapping[str, tuple[float, ...]], near: _Point, within: float) -> tuple[str, str]:
    """The place nearest to a point, and how far it is."""
    target = near.metres
    if not places:
        raise GraphError("expected a graph with places (got none)")
    away = {id_: math.dist(at[: len(target)], target) for id_, at in places.items()}
    place = min(away, key=lambda id_: (away[id_], id_))
    if away[place] > within:
        raise GraphError(
            f"expected a place within {within:g} m of {near.option} {near.said} (got {away[place]:.1f} m to "
            f"{short_id(place)} at {point(places[place])}; --within METRES allows more)"
        )
    return place, f", {away[place]:.2f} m from {near.said}"
