"""Where a map is: a file, or a server by its address; opened to be read, changed or built anew."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.screen import note
from semloc_core.errors import MapError
from semloc_core.fleet import INDEX_KINDS, is_address, parse_address

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.fleet import FleetDatabase, MilvusAddress
    from semloc_core.map_database import ReadableMap, WritableMap

MapPlace = Annotated[
    str, typer.Argument(metavar="MAP", help="The map: a file, or milvus+http://host:port/name on a server.")
]
Address = Annotated[
    str, typer.Argument(metavar="ADDRESS", help="A map on a server: milvus+http://host:port/name (or milvus+https).")
]
Patterns = Annotated[
    list[str] | None,
    typer.Option("--buildings", metavar="PATTERN", help="Only buildings such as 'hq/*'; may be repeated."),
]
Index = Annotated[
    str | None,
    typer.Option(
        "--index",
        metavar="KIND",
        help="Index of a new map on a server: HNSW (default), FLAT (exact), IVF_FLAT, IVF_SQ8, DISKANN or AUTOINDEX.",
    ),
]


def only_a_file(place: str) -> Path:
    """The file that an argument must be: the parser of such arguments, as a path no longer shows an address."""
    if "://" in place:
        said = ": " + place if "@" not in place else ""  # what could be a password is not repeated
        raise MapError(f"expected a map file (got an address; semloc map pull makes a file of it{said})")
    return Path(place)


def address_of(place: str) -> MilvusAddress:
    """The address that an argument must be."""
    if not is_address(place):
        raise MapError(f"expected an address milvus+http://host:port/name (got {place!r})")
    return parse_address(place)


def server_map(place: str) -> FleetDatabase:
    """A map on a server, opened."""
    from semloc_core.fleet import FleetDatabase

    return FleetDatabase.open(address_of(place))


@contextmanager
def to_read(place: str) -> Iterator[tuple[ReadableMap, Model]]:
    """A map and its model."""
    if is_address(place):
        with server_map(place) as database:
            yield database, database.model
        return
    from semloc_core.map_database import load

    loaded = load(place)
    yield loaded, loaded.model


@contextmanager
def to_change(place: str) -> Iterator[tuple[WritableMap, Model]]:
    """A map that is whole, open for changes, and its model."""
    if is_address(place):
        with server_map(place) as database:
            yield database, database.model
        return
    from semloc_core.map_database import MapDatabase, load

    model = load(place).model
    with MapDatabase.open(place) as file:
        file.require(model.hash, model.labelspace.hash)
        yield file, model


def refuse_existing(place: str) -> None:
    """Refuse to build where a map is already; on a server one without buildings does no harm."""
    if not is_address(place):
        if Path(place).exists():
            raise MapError(f"expected a new file, or --force to replace one (got {place}, which exists)")
        return
    from semloc_core.fleet import map_exists

    if map_exists(parse_address(place)):
        with server_map(place) as database:
            if names := database.buildings:
                raise MapError(f"expected a new map, or --force to replace one (got {len(names)} buildings at {place})")


@contextmanager
def fresh(place: str, model: Model, index: str | None = None) -> Iterator[WritableMap]:
    """A map without buildings at this place, once the block ends well; else what was there before."""
    from semloc_core.map_database import MapDatabase

    if is_address(place):
        with _fresh_on_server(parse_address(place), model, index) as there:
            yield there
        return
    if index is not None:
        raise MapError(f"expected --index with a map on a server (got {place}, a file, which has none)")
    output = Path(place)
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


def tell_no_effect(index: str | None, address: MilvusAddress) -> None:
    """Say that a map that is there keeps the index it was made with."""
    if index is not None:
        note(f"--index {index} has no effect: {address} was made before, and keeps the index that it has")


@contextmanager
def _fresh_on_server(address: MilvusAddress, model: Model, index: str | None) -> Iterator[FleetDatabase]:
    """A new map, or in place of one that is there."""
    from semloc_core.fleet import FleetDatabase, map_exists

    if map_exists(address):
        tell_no_effect(index, address)
        with FleetDatabase.open(address) as database, database.transaction():
            database.reset(model)
            yield database
        return
    with FleetDatabase.create(address, model, index=index or INDEX_KINDS[0]) as database, database.transaction():
        yield database
