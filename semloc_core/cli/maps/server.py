"""``semloc map push``, ``pull`` and ``sweep``: maps on servers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import console
from semloc_core.cli.shared.map_places import (
    Address,
    Index,
    Patterns,
    address_of,
    fresh,
    map_that_was,
    only_a_file,
    server_map,
    tell_no_effect,
)
from semloc_core.cli.shared.outputs import Force, Writes
from semloc_core.cli.shared.screen import many
from semloc_core.files import MAP


def push(
    map_file: Annotated[Path, typer.Argument(metavar="FILE", parser=only_a_file, help="The map file.")],
    address: Address,
    buildings: Patterns = None,
    index: Index = None,
) -> None:
    """Copy the buildings of a map file to a map on a server, which is made where there is none.

    A building that the server has by that name is replaced, the others stay. Both maps must be of one model.
    """
    from semloc_core.fleet import INDEX_KINDS, FleetDatabase, map_exists
    from semloc_core.fleet import push as copy
    from semloc_core.map_database import load

    loaded, there = load(map_file), address_of(address)
    if index is not None and map_exists(there):
        tell_no_effect(index, there)
        index = None
    kind = index or INDEX_KINDS[0]
    with FleetDatabase.create(there, loaded.model, exist_ok=True, index=kind) as database:
        written, alike = copy(loaded, database, buildings or ())
        console.print(
            f"{address}: {many(written, 'building')} written, {alike} were there already; "
            f"{len(database.buildings)} in all, hash {database.meta.content_hash}"
        )


def pull(
    address: Address,
    map_file: Annotated[Path, typer.Argument(metavar="FILE", parser=Writes(MAP), help="The map file to write.")],
    buildings: Patterns = None,
    force: Force = False,
) -> None:
    """Copy buildings of a map on a server into a map file: all of them, or those of a site."""
    from semloc_core.fleet import pull as copy
    from semloc_core.map_database import load

    was = map_that_was(map_file)
    with server_map(address) as database, fresh(str(map_file), database.model, was) as file:
        count = copy(database, file, buildings or ())
    console.print(f"{map_file}: {many(count, 'building')}, hash {load(map_file).hash}")


def sweep(
    address: Address,
    older_than: Annotated[
        float,
        typer.Option(
            "--older-than",
            metavar="SECONDS",
            min=60,
            help="Leave alone what was written or replaced less than this ago: writers may be at work on it.",
        ),
    ] = 3600.0,
) -> None:
    """Delete from a server what no building of the map consists of any more; writers that were killed leave some."""
    with server_map(address) as database:
        console.print(f"{address}: {many(database.sweep(older_than), 'left-over generation')} deleted")
