"""``semloc map add``, ``replace``, ``remove`` and ``merge``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import (
    Json,
    LabelspaceOption,
    RobotOption,
    SynonymsOption,
    TopicOption,
    building_name,
    console,
    read_graph_or_run,
    write_json,
)
from semloc_core.cli.shared.foreign_classes import AllowUnknown, check_classes
from semloc_core.cli.shared.map_places import MapPlace, to_change, to_read
from semloc_core.cli.shared.screen import many
from semloc_core.errors import MapError

if TYPE_CHECKING:
    from semloc_core.graph import Reading, SceneGraph
    from semloc_core.map_merge import Merged
    from semloc_core.metrics import Row

Inputs = Annotated[list[Path], typer.Argument(metavar="GRAPH|RUN...", help="Buildings: graphs or recorded runs.")]
Name = Annotated[
    str | None, typer.Option("--name", help="The building's name (one input only); default: the file's name.")
]
Places = Annotated[
    list[str] | None,
    typer.Option("--place", metavar="ID", help="Only this place of a building that the map has; may be repeated."),
]


def names_of(inputs: list[Path], name: str | None) -> list[str]:
    """Names of the buildings that inputs hold; all different."""
    if name is not None and len(inputs) != 1:
        raise MapError(f"expected one input with --name (got {len(inputs)})")
    names = [name] if name is not None else [building_name(path) for path in inputs]
    if len(set(names)) != len(names):
        raise MapError(
            f"expected buildings of different names (got {', '.join(names)}); add them one by one with --name"
        )
    return names


def read_known(path: Path, reading: Reading, allow_unknown: bool) -> SceneGraph:
    """Read a GRAPH or RUN with places, and say which of its classes the map lacks, or refuse it for these.

    Args:
        path: the file or folder.
        reading: of labels, for a map.
        allow_unknown: take it even if the map knows few of its objects.

    """
    graph, space = read_graph_or_run(path, reading), reading.space
    assert space is not None
    check_classes(graph, space, str(path), allow_unknown=allow_unknown)
    if not graph.places:
        raise MapError(f"expected a graph with places (got {path}, which has none)")
    return graph


ADD = "Add buildings, embedded by the map's own model; with --place single places of a building that the map has."
REPLACE = "Replace buildings that the map has by newer graphs or runs of them; with --place single places."


def put(
    context: typer.Context,
    map_place: MapPlace,
    inputs: Inputs,
    name: Name = None,
    places: Places = None,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    allow_unknown: AllowUnknown = False,
    topic: TopicOption = None,
    robot: RobotOption = None,
) -> None:
    """The commands ``add`` and ``replace``: which of the two, the context says."""
    from semloc_core.graph import Reading
    from semloc_core.map_merge import put_building, store_edited, with_places

    replace = context.info_name == "replace"
    done, said = "replaced" if replace else "added", list[str]()
    if places and len(inputs) != 1:
        raise MapError(f"expected one input with --place (got {len(inputs)})")
    reading = Reading.of(labelspace, synonyms, topic=topic, robot=robot)
    with to_change(map_place) as (database, model), database.transaction():
        reading = reading.with_known(model.labelspace)
        for path, building in zip(inputs, names_of(inputs, name), strict=True):
            graph = read_known(path, reading, allow_unknown)
            if places:
                edited = with_places(database.graph(building), graph, set(places), replace=replace)
                store_edited(database, model, building, edited)
                said.append(f"{building}: {len(set(places))} of its places {done}")
            else:
                count = put_building(database, model, graph, building, source=path.name, replace=replace)
                said.append(f"{building}: {many(count, 'place')} {done}")
    _say_done(said)


def _say_done(said: list[str]) -> None:
    """A line a change, once it is in the map: one that fails undoes the others with it."""
    for text in said:
        console.print(text)


def remove(
    map_place: MapPlace,
    names: Annotated[list[str], typer.Argument(metavar="BUILDING...", help="Names of buildings.")],
    place: Places = None,
) -> None:
    """Remove buildings; with --place single places of one."""
    from semloc_core.map_merge import embed_again, map_weights, store_edited, without_places

    if place and len(names) != 1:
        raise MapError(f"expected one building with --place (got {len(names)})")
    with to_change(map_place) as (database, model), database.transaction():
        before, said = map_weights(database, model), []
        for name in names:
            if place:
                store_edited(database, model, name, without_places(database.graph(name), set(place)))
                said.append(f"{name}: {len(set(place))} of its places removed")
            else:
                database.remove_building(name)
                said.append(f"{name}: removed")
        if map_weights(database, model) != before:  # what it taught of classes is gone
            embed_again(database, model, database.buildings)
    _say_done(said)


def merge(
    map_place: MapPlace,
    traversal: Annotated[
        Path | None,
        typer.Argument(metavar="[GRAPH|RUN]", help="A later traversal, in any frame whose z axis is up."),
    ] = None,
    building: Annotated[
        str | None, typer.Option("--building", metavar="NAME", help="Merge into this one; default: where it fits best.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would change, and change nothing.")] = False,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    take_back: Annotated[
        bool,
        typer.Option("--undo", help="Take the last merge back, one step; no other change may have come since."),
    ] = False,
    allow_unknown: AllowUnknown = False,
    topic: TopicOption = None,
    robot: RobotOption = None,
    json_file: Json = None,
    force: Annotated[
        bool,
        typer.Option("--force", help="Merge what was merged before again, and replace the file of figures."),
    ] = False,
) -> None:
    """Merge a later traversal of a building that the map has: what it confirms, moves, misses and adds.

    It is laid on the building by what it saw, and refused where that does not fit. Objects that were confirmed gain
    weight, those not seen where free space was seen lose it, by how often their class moves; places are embedded anew.
    A run that was merged before is refused. With --undo the building is as it was before the last merge.
    """
    from semloc_core.graph import Reading
    from semloc_core.map_merge import merge_into, propose, undo

    if take_back:
        if traversal is not None or dry_run or json_file is not None:
            raise MapError("expected --undo without a run, --dry-run or --json (got one of them)")
        with to_change(map_place) as (database, model):
            name, gone = undo(database, model, building)
        console.print(f"{name}: as before {gone.source or 'the last run'} was merged")
        return
    if traversal is None:
        raise MapError("expected a GRAPH or RUN to merge, or --undo (got neither)")
    reading = Reading.of(labelspace, synonyms, topic=topic, robot=robot)
    if dry_run:
        with to_read(map_place) as (map_, model):
            graph = read_known(traversal, reading.with_known(model.labelspace), allow_unknown)
            name, merged = propose(map_, model, graph, building, source=traversal.name, again=force)
    else:
        with to_change(map_place) as (database, model):
            graph = read_known(traversal, reading.with_known(model.labelspace), allow_unknown)
            name, merged = merge_into(database, model, graph, building, source=traversal.name, again=force)
    _say(name, merged, "would be " if dry_run else "")
    if json_file is not None:
        row: Row = {"method": model.encoder.name, "scope": name, **_figures(merged)}
        write_json(json_file, "map merge", 0, [map_place, traversal], [row])


def _say(name: str, merged: Merged, would: str) -> None:
    at, result = merged.alignment, merged.traversal
    x, y, z = at.transform.translation
    console.print(
        f"{name}: laid on it by {at.pairs.shape[1]} objects, {at.residual_m:.2f} m apart (rms); "
        f"turned by {math.degrees(at.transform.yaw):.1f}°, shifted by ({x:.2f}, {y:.2f}, {z:.2f}) m"
    )
    console.print(
        f"{name}: objects {would}confirmed {result.confirmed}, moved {result.moved}, missing {result.missing}, "
        f"added {result.added}, forgotten {result.forgotten}; places added {result.places}"
    )


def _figures(merged: Merged) -> dict[str, int | float]:
    result, at = merged.traversal, merged.alignment
    counts = {key: getattr(result, key) for key in ("confirmed", "moved", "missing", "added", "forgotten", "places")}
    return {"agreeing": at.pairs.shape[1], "residual_m": at.residual_m, "yaw": at.transform.yaw, **counts}
