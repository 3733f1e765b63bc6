"""``semloc map``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.common import (
    Json,
    building_name,
    console,
    progress,
    read_graph_or_run,
    report_unknown_classes,
    show,
)
from semloc_core.errors import MapError

if TYPE_CHECKING:
    from semloc_core.map_database import MapDatabase
    from semloc_core.model import Model

app = typer.Typer(no_args_is_help=True, help="Build and change map databases.")

Inputs = Annotated[list[Path], typer.Argument(metavar="GRAPH|RUN...", help="Buildings: graphs or recorded runs.")]
MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="The map database.")]
Name = Annotated[
    str | None, typer.Option("--name", help="The building's name (one input only); default: the file's name.")
]


def _names(inputs: list[Path], name: str | None) -> list[str]:
    if name is not None and len(inputs) != 1:
        raise MapError(f"expected one input with --name (got {len(inputs)})")
    names = [name] if name is not None else [building_name(path) for path in inputs]
    if len(set(names)) != len(names):
        raise MapError(
            f"expected buildings of different names (got {', '.join(names)}); add them one by one with --name"
        )
    return names


def _put(database: MapDatabase, model: Model, path: Path, name: str, replace: bool) -> int:
    from semloc_core.graph_arrays import GraphArrays
    from semloc_core.labelspace import count_unknown
    from semloc_core.model import embed_graph

    graph = read_graph_or_run(path, model.labelspace)
    report_unknown_classes(count_unknown(graph, model.labelspace), str(path))
    if not graph.places:
        raise MapError(f"expected a graph with places (got {path}, which has none)")
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace, name)
    put = database.replace_building if replace else database.add_building
    put(name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))
    return arrays.n_places


@app.command("build")
def build(
    inputs: Inputs,
    model: Annotated[Path, typer.Option("--model", metavar="MODEL", help="The trained encoder.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MAP", help="Where to write the map.")],
    name: Name = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Build a map database: every place of every building, embedded; the file carries the model too."""
    from semloc_core.map_database import MapDatabase
    from semloc_core.model import Model

    names, loaded, places = _names(inputs, name), Model.load(model), 0
    with MapDatabase.build(output, loaded, replace=force) as database, progress("embedding places") as bar:
        for i, (path, building) in enumerate(zip(inputs, names, strict=True)):
            bar(i, len(inputs), building)
            places += _put(database, loaded, path, building, replace=False)
    console.print(f"{output}: {places} places in {len(inputs)} building{'s' if len(inputs) != 1 else ''}")


@app.command("info")
def info(map_file: MapFile, json_file: Json = None) -> None:
    """Say what is in a map: buildings, places, classes, model, hashes."""
    from semloc_core.map_database import describe

    facts = describe(map_file)
    rows = [{"method": facts["model"]["name"], "scope": b["name"], **_counts(b)} for b in facts["buildings"]]
    console.print(f"map {map_file}: format {facts['format']}, hash {facts['hash']}")
    console.print(f"model {facts['model']['name']} {facts['model']['hash'][:12]}, {facts['model']['config']}")
    console.print(f"labelspace {facts['labelspace']['name']}: {', '.join(facts['labelspace']['classes'])}")
    show("map info", 0, [map_file], rows, json_file, title="buildings")


def _counts(building: dict[str, object]) -> dict[str, object]:
    return {key: building[key] for key in ("places", "objects")}


@app.command("add")
def add(map_file: MapFile, inputs: Inputs, name: Name = None) -> None:
    """Add buildings, embedded by the map's own model."""
    _change(map_file, inputs, name, replace=False)


@app.command("replace")
def replace(map_file: MapFile, inputs: Inputs, name: Name = None) -> None:
    """Replace buildings that the map has by newer graphs or runs of them."""
    _change(map_file, inputs, name, replace=True)


def _change(map_file: Path, inputs: list[Path], name: str | None, replace: bool) -> None:
    from semloc_core.map_database import MapDatabase

    with MapDatabase.open(map_file) as database:
        for path, building in zip(inputs, _names(inputs, name), strict=True):
            places = _put(database, database.model, path, building, replace)
            console.print(f"{building}: {places} places {'replaced' if replace else 'added'}")


@app.command("remove")
def remove(
    map_file: MapFile, names: Annotated[list[str], typer.Argument(metavar="BUILDING...", help="Names of buildings.")]
) -> None:
    """Remove buildings."""
    from semloc_core.map_database import MapDatabase

    with MapDatabase.open(map_file) as database:
        for name in names:
            database.remove_building(name)
            console.print(f"{name}: removed")
