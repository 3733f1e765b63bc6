"""``semloc map``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.common import (
    Json,
    SynonymsOption,
    building_name,
    console,
    join_synonyms,
    progress,
    read_graph_or_run,
    report_unknown_classes,
    show,
)
from semloc_core.errors import MapError

if TYPE_CHECKING:
    from semloc_core.evaluate.rows import Row
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
    put(name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays), source=path.name)
    return arrays.n_places


@contextmanager
def _fresh(output: Path, model: Model) -> Iterator[MapDatabase]:
    """A map without buildings under this name, once the block ends well; else what was there before."""
    from semloc_core.map_database import MapDatabase

    if output.exists():  # other processes may have it open, so it is changed in place, in one transaction
        with MapDatabase.open(output) as database, database.transaction():
            database.reset(model)
            yield database
        return
    unfinished = output.with_name(f".{output.name}.unfinished")
    unfinished.unlink(missing_ok=True)
    try:
        with MapDatabase.create(unfinished, model) as database:
            yield database
        unfinished.replace(output)
    finally:
        unfinished.unlink(missing_ok=True)


@app.command("build")
def build(
    inputs: Inputs,
    model: Annotated[Path, typer.Option("--model", metavar="MODEL", help="The trained encoder.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MAP", help="Where to write the map.")],
    name: Name = None,
    synonyms: SynonymsOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Build a map database: every place of every building, embedded; the file carries the model too."""
    from semloc_core.model import Model

    if output.exists() and not force:
        raise MapError(f"expected a new file, or --force to replace one (got {output}, which exists)")
    names, loaded, places = _names(inputs, name), Model.load(model), 0
    join_synonyms(loaded, synonyms)
    with _fresh(output, loaded) as database, progress("embedding places") as bar:
        for i, (path, building) in enumerate(zip(inputs, names, strict=True)):
            bar(i, len(inputs), building)
            places += _put(database, loaded, path, building, replace=False)
    console.print(f"{output}: {places} places in {len(inputs)} building{'s' if len(inputs) != 1 else ''}")


@app.command("info")
def info(
    map_file: MapFile,
    aliasing: Annotated[
        bool, typer.Option("--aliasing/--no-aliasing", help="Say how many places class labels can tell apart.")
    ] = True,
    json_file: Json = None,
) -> None:
    """Say what is in a map: buildings, places, classes, model, hashes; and what its labels can tell apart."""
    from semloc_core.map_database import describe

    facts = describe(map_file)
    model, space = facts["model"], facts["labelspace"]
    console.print(f"map {facts['name']}: {facts['places']} places, {facts['bytes']} bytes, hash {facts['hash']}")
    config = ", ".join(f"{key} {value}" for key, value in model["config"].items())
    console.print(f"model {model['name']} {model['hash'][:12]}: {facts['dimension']} numbers a place; {config}")
    console.print(f"labelspace {space['name']} {space['hash'][:12]}: {space['classes']} classes")
    rows = [
        {"method": model["name"], "scope": b["name"], "places": b["places"], "objects": b["objects"]}
        for b in facts["buildings"]
    ]
    alike = _aliasing(map_file) if aliasing else []
    show("map info", 0, [map_file], rows, None, title="buildings")
    for building in facts["buildings"]:
        classes = ", ".join(f"{name} {count}" for name, count in building["classes"].items())
        console.print(f"{building['name']}: {classes or 'no objects'}")
    if alike:
        show("map info", 0, [map_file], alike, None, title="aliasing: what class labels can tell apart")
        console.print(
            "colours: kinds of places that no encoder of labels can split; alone: places of a kind of their own; far "
            "aliases: places alike to one more than 4 m away; the ceiling is of success@1, the query a place as mapped"
        )
    elif aliasing:
        console.print(f"{model['name']} reads distances too: labels set no ceiling to what it can tell apart")
    if json_file is not None:
        from semloc_core.evaluate.table import document

        json_file.write_bytes(document("map info", 0, [str(map_file)], [*rows, *alike]))


def _aliasing(map_file: Path) -> list[Row]:
    """A row a building, and one for all together where there are several."""
    from semloc_core.evaluate.aliasing import map_aliasing
    from semloc_core.graph_arrays import GraphArrays
    from semloc_core.map_database import load

    loaded = load(map_file)
    space, encoder = loaded.model.labelspace, loaded.model.encoder
    buildings = [GraphArrays.from_scene_graph(loaded.graph(name), space, name) for name in loaded.buildings]
    scopes = [(arrays.name, [arrays]) for arrays in buildings] + ([("all", buildings)] if len(buildings) > 1 else [])
    found = [(scope, map_aliasing(encoder, some, len(space))) for scope, some in scopes]
    return [one.row(encoder.name, scope) for scope, one in found if one is not None]


@app.command("add")
def add(map_file: MapFile, inputs: Inputs, name: Name = None) -> None:
    """Add buildings, embedded by the map's own model."""
    _change(map_file, inputs, name, replace=False)


@app.command("replace")
def replace(map_file: MapFile, inputs: Inputs, name: Name = None) -> None:
    """Replace buildings that the map has by newer graphs or runs of them."""
    _change(map_file, inputs, name, replace=True)


def _change(map_file: Path, inputs: list[Path], name: str | None, replace: bool) -> None:
    from semloc_core.map_database import MapDatabase, load

    model = load(map_file).model
    with MapDatabase.open(map_file) as database, database.transaction():
        database.require(model.hash, model.labelspace.hash)
        for path, building in zip(inputs, _names(inputs, name), strict=True):
            places = _put(database, model, path, building, replace)
            console.print(f"{building}: {places} places {'replaced' if replace else 'added'}")


@app.command("remove")
def remove(
    map_file: MapFile, names: Annotated[list[str], typer.Argument(metavar="BUILDING...", help="Names of buildings.")]
) -> None:
    """Remove buildings."""
    from semloc_core.map_database import MapDatabase

    with MapDatabase.open(map_file) as database, database.transaction():
        for name in names:
            database.remove_building(name)
            console.print(f"{name}: removed")
