"""``semloc map``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli import map_changes
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
from semloc_core.cli.map_changes import Inputs, MapFile, Name, names_of, put
from semloc_core.errors import MapError

if TYPE_CHECKING:
    from semloc_core.evaluate.rows import Row
    from semloc_core.map_database import MapDatabase
    from semloc_core.model import Model

app = typer.Typer(no_args_is_help=True, help="Build and change map databases.")


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
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MAP", help="Where to write the map.")],
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
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Build a map database: every place of every building, embedded; the file carries the model too."""
    if output.exists() and not force:
        raise MapError(f"expected a new file, or --force to replace one (got {output}, which exists)")
    names, places = names_of(inputs, name), 0
    loaded = choose_model(model, inputs, pick_labelspace(labelspace), synonyms)
    with _fresh(output, loaded) as database, progress("embedding places") as bar:
        for i, (path, building) in enumerate(zip(inputs, names, strict=True)):
            bar(i, len(inputs), building)
            places += put(database, loaded, path, building, replace=False)
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
        if building["traversals"]:
            rates = sorted(building["moved"].items(), key=lambda item: (-item[1], item[0]))
            moved = ", ".join(f"{name} {rate:.2f}" for name, rate in rates)
            console.print(f"{building['name']}: {building['traversals']} traversals merged; share that moves: {moved}")
    if alike:
        show("map info", 0, [map_file], alike, None, title="aliasing: what class labels can tell apart")
        console.print(
            "colours: kinds of places that no encoder of labels can split; alone: places of a kind of their own; far "
            "aliases: places alike to one more than 4 m away; the ceiling is of success@1, the query a place as mapped"
        )
    elif aliasing:
        console.print(f"{model['name']} reads distances too: labels set no ceiling to what it can tell apart")
    if json_file is not None:
        write_json(json_file, "map info", 0, [map_file], [*rows, *alike])


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


app.command("add")(map_changes.add)
app.command("replace")(map_changes.replace)
app.command("remove")(map_changes.remove)
app.command("merge")(map_changes.merge)
