"""``semloc map``."""

from __future__ import annotations

from typing import Annotated

import typer

from semloc_core.cli.maps import changes as map_changes
from semloc_core.cli.maps import info as map_info
from semloc_core.cli.maps import server as map_server
from semloc_core.cli.maps.changes import Inputs, Name, names_of, read_known
from semloc_core.cli.shared.choose_model import choose_model
from semloc_core.cli.shared.common import (
    LabelspaceOption,
    RobotOption,
    SynonymsOption,
    TopicOption,
    console,
    progress,
)
from semloc_core.cli.shared.foreign_classes import AllowUnknown
from semloc_core.cli.shared.map_places import Index, fresh, map_that_was, refuse_existing
from semloc_core.cli.shared.outputs import App, Force, output_option
from semloc_core.cli.shared.screen import many
from semloc_core.files import MAP

app = App(no_args_is_help=True, help="Build and change map databases.")


@app.command("build")
def build(
    inputs: Inputs,
    output: Annotated[str, output_option("MAP", MAP, "Where to write the map: a file or an address.", address=True)],
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="MODEL|general",
            help="The trained encoder; none given, or 'general': the general one, which takes any class names and is "
            "fitted to these buildings at once.",
        ),
    ] = None,
    labelspace: LabelspaceOption = None,
    name: Name = None,
    synonyms: SynonymsOption = None,
    allow_unknown: AllowUnknown = False,
    topic: TopicOption = None,
    robot: RobotOption = None,
    force: Force = False,
    index: Index = None,
) -> None:
    """Build a map database: every place of every building, embedded; the file carries the model too."""
    from semloc_core.graph import Reading
    from semloc_core.map_merge import put_building

    if not force:
        refuse_existing(output)
    names, places, was = names_of(inputs, name), 0, map_that_was(output)
    reading = Reading.of(labelspace, synonyms, topic=topic, robot=robot)
    loaded = choose_model(model, inputs, reading)
    reading = reading.with_known(loaded.labelspace)
    with fresh(output, loaded, was, index) as database, progress("embedding places") as bar:
        for i, (path, building) in enumerate(zip(inputs, names, strict=True)):
            bar(i, len(inputs), building)
            graph = read_known(path, reading, allow_unknown)
            places += put_building(database, loaded, graph, building, source=path.name)
    console.print(f"{output}: {many(places, 'place')} in {many(len(inputs), 'building')}")


app.command("info")(map_info.info)
app.command("add", help=map_changes.ADD)(map_changes.put)
app.command("replace", help=map_changes.REPLACE)(map_changes.put)
app.command("remove")(map_changes.remove)
app.command("merge")(map_changes.merge)
app.command("push")(map_server.push)
app.command("pull")(map_server.pull)
app.command("sweep")(map_server.sweep)
