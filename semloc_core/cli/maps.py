"""``semloc map``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from semloc_core.cli import map_changes, map_server
from semloc_core.cli.choose_model import choose_model
from semloc_core.cli.common import (
    Json,
    LabelspaceOption,
    SynonymsOption,
    console,
    pick_labelspace,
    progress,
    show,
    write_json,
)
from semloc_core.cli.foreign_classes import AllowUnknown
from semloc_core.cli.map_changes import Inputs, Name, names_of, put, read_known
from semloc_core.cli.map_places import Index, MapPlace, fresh, refuse_existing, to_read
from semloc_core.fleet.address import is_address

if TYPE_CHECKING:
    from semloc_core.evaluate.rows import Row
    from semloc_core.map_database.protocols import ReadableMap
    from semloc_core.model import Model

app = typer.Typer(no_args_is_help=True, help="Build and change map databases.")


@app.command("build")
def build(
    inputs: Inputs,
    output: Annotated[
        str,
        typer.Option("-o", "--output", metavar="MAP", help="Where to write the map: a file or an address."),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="MODEL|NAME",
            help="The trained encoder, or a shipped general one (coco, uhumans2_office); none given: the general one "
            "that knows the most of the objects.",
        ),
    ] = None,
    labelspace: LabelspaceOption = None,
    name: Name = None,
    synonyms: SynonymsOption = None,
    allow_unknown: AllowUnknown = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing map.")] = False,
    index: Index = "HNSW",
) -> None:
    """Build a map database: every place of every building, embedded; the file carries the model too."""
    if not force:
        refuse_existing(output)
    names, places = names_of(inputs, name), 0
    space = pick_labelspace(labelspace)
    loaded = choose_model(model, inputs, space, synonyms)
    with fresh(output, loaded, index) as database, progress("embedding places") as bar:
        for i, (path, building) in enumerate(zip(inputs, names, strict=True)):
            bar(i, len(inputs), building)
            graph = read_known(path, loaded, allow_unknown, space)
            places += put(database, loaded, graph, building, path.name, replace=False)
    console.print(f"{output}: {places} places in {len(inputs)} building{'s' if len(inputs) != 1 else ''}")


@app.command("info")
def info(
    map_place: MapPlace,
    aliasing: Annotated[
        bool, typer.Option("--aliasing/--no-aliasing", help="Say how many places class labels can tell apart.")
    ] = True,
    json_file: Json = None,
) -> None:
    """Say what is in a map: buildings, places, classes, model, hashes; and what its labels can tell apart."""
    facts = _facts(map_place)
    model, space = facts["model"], facts["labelspace"]
    console.print(f"map {facts['name']}: {facts['places']} places, {_size(facts)}hash {facts['hash']}")
    config = ", ".join(f"{key} {value}" for key, value in model["config"].items())
    console.print(f"model {model['name']} {model['hash'][:12]}: {facts['dimension']} numbers a place; {config}")
    console.print(f"labelspace {space['name']} {space['hash'][:12]}: {space['classes']} classes")
    rows = [
        {"method": model["name"], "scope": b["name"], "places": b["places"], "objects": b["objects"]}
        for b in facts["buildings"]
    ]
    alike = _aliasing(map_place) if aliasing else []
    show("map info", 0, [map_place], rows, None, title="buildings")
    for building in facts["buildings"]:
        classes = ", ".join(f"{name} {count}" for name, count in building["classes"].items())
        console.print(f"{building['name']}: {classes or 'no objects'}")
        if building["traversals"]:
            rates = sorted(building["moved"].items(), key=lambda item: (-item[1], item[0]))
            moved = ", ".join(f"{name} {rate:.2f}" for name, rate in rates)
            console.print(f"{building['name']}: {building['traversals']} traversals merged; share that moves: {moved}")
    if alike:
        show("map info", 0, [map_place], alike, None, title="aliasing: what class labels can tell apart")
        console.print(
            "colours: kinds of places that no encoder of labels can split; alone: places of a kind of their own; far "
            "aliases: places alike to one more than 4 m away; the ceiling is of success@1, the query a place as mapped"
        )
    elif aliasing:
        console.print(f"{model['name']} reads distances too: labels set no ceiling to what it can tell apart")
    if json_file is not None:
        write_json(json_file, "map info", 0, [map_place], [*rows, *alike])


def _facts(place: str) -> dict[str, Any]:
    if is_address(place):
        from semloc_core.cli.map_places import server_map
        from semloc_core.fleet.info import describe_server_map

        with server_map(place) as database:
            return describe_server_map(database)
    from semloc_core.map_database import describe

    return describe(place)


def _size(facts: dict[str, Any]) -> str:
    return f"{facts['bytes']} bytes, " if "bytes" in facts else ""


def _aliasing(place: str) -> list[Row]:
    """A row a building, and one for all together where there are several."""
    with to_read(place) as (map_, model):
        return _aliasing_rows(map_, model)


def _aliasing_rows(map_: ReadableMap, model: Model) -> list[Row]:
    from semloc_core.evaluate.aliasing import map_aliasing
    from semloc_core.graph_arrays import GraphArrays

    space, encoder = model.labelspace, model.encoder
    buildings = [GraphArrays.from_scene_graph(map_.graph(name), space, name) for name in map_.buildings]
    scopes = [(arrays.name, [arrays]) for arrays in buildings] + ([("all", buildings)] if len(buildings) > 1 else [])
    found = [(scope, map_aliasing(encoder, some, len(space))) for scope, some in scopes]
    return [one.row(encoder.name, scope) for scope, one in found if one is not None]


app.command("add")(map_changes.add)
app.command("replace")(map_changes.replace)
app.command("remove")(map_changes.remove)
app.command("merge")(map_changes.merge)
app.command("push")(map_server.push)
app.command("pull")(map_server.pull)
app.command("sweep")(map_server.sweep)
