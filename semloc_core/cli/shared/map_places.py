"""Where a map is: a file, or a server by its address; opened to be read, changed or built anew."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
    if not is_address(place):  # `semloc_core.files.outputs` has looked
        return
    from semloc_core.fleet import map_exists

    if map_exists(parse_address(place)):
        with server_map(place) as database:
            if names := database.buildings:
                raise MapError(f"expected a new map, or --force to replace one (got {len(names)} buildings at {place})")


@dataclass(frozen=True)
class Was:
    """Which map was in a file when a command began; none of these: no map."""

    content_hash: str = ""
    generation: int = -1
    inode: int = -1


def map_that_was(place: str | Path) -> Was:
    """Which map is in a file, to be asked before work on another begins; of a server nothing is kept in mind."""
    from semloc_core.map_database import read, read_meta

    path = Path(place)
    if is_address(str(place)) or not path.exists() or not path.stat().st_size:
        return Was()
    meta = read(path, read_meta)
    return Was(meta.content_hash, meta.generation, path.stat().st_ino)


@contextmanager
def fresh(place: str, model: Model, was: Was, index: str | None = None) -> Iterator[WritableMap]:
    """A map without buildings at this place, once the block ends well; else what was there before.

    Args:
        place: a file or an address.
        model: of the map.
        was: what the file held when the command began. A file that holds another map by now stays as it is.
        index: of a map on a server.

    """
    from semloc_core.files import real, scratch_folder
    from semloc_core.map_database import MapDatabase, publish_map

    if is_address(place):
        with _fresh_on_server(parse_address(place), model, index) as there:
            yield there
        return
    if index is not None:
        raise MapError(f"expected --index with a map on a server (got {place}, a file, which has none)")
    output = Path(real(place))
    lost = MapError(f"expected to put a map at {place} (got one that another process has written meanwhile)")
    if output.exists() and output.stat().st_size:
        # Others may have it open, so it is changed in place, in one transaction, which waits for other writers.
        with MapDatabase.open(output) as database, database.transaction():
            if Was(database.meta.content_hash, database.meta.generation, output.stat().st_ino) != was:
                raise lost
            database.reset(model)
            yield database
        return
    with scratch_folder(output) as folder:  # with its log, so that nothing of it is left whatever ends the work
        with MapDatabase.create(folder / output.name, model) as database:
            yield database
        if output.exists() and not output.stat().st_size:
            output.unlink()
        try:
            publish_map(folder / output.name, output)
        except MapError:
            raise lost from None


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
