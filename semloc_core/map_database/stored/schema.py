"""A map file as SQLite sees it: tables, format version, how it is opened, and what its errors mean.

Write-ahead log: a reader never blocks a writer, nor a writer a reader; writers wait for each other. The last
connection to close leaves one file. A process killed at any moment leaves the last committed state, which the next
one to open finds. A file where nothing can be written beside it (a read-only folder, a full disk) is read as it
stands.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from semloc_core.errors import MapError
from semloc_core.files import APPLICATION_ID, MAP, link_new, other_kind, scratch_folder
from semloc_core.map_database.stored.records import keep_storeys

FORMAT_VERSION = 3
BUSY_TIMEOUT_S = 30.0
MAX_BLOB_BYTES = 512 * 2**20  # of any one value: the model, a compressed scene graph
SIDECARS = ("-wal", "-shm", "-journal")
ROOM_BYTES = 64 * 2**10  # what SQLite puts beside a map to open it at all: an index of the log, the log's beginning
PAGE_BYTES = 8192  # a place with an embedding of up to some 450 numbers fits into a page

# The canonical text: a file whose schema reads otherwise is not a map (no trigger, view or index may hide in one).
_TABLES_1 = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    "CREATE TABLE model (id INTEGER PRIMARY KEY CHECK (id = 0), data BLOB NOT NULL)",
    "CREATE TABLE building (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, source TEXT NOT NULL, "
    "frame_id TEXT NOT NULL, stamp_ns INTEGER, digest TEXT, graph_digest TEXT NOT NULL, "
    "graph_bytes INTEGER NOT NULL, graph BLOB NOT NULL)",
    "CREATE TABLE place (building INTEGER NOT NULL REFERENCES building (id), id TEXT NOT NULL, x REAL NOT NULL, "
    "y REAL NOT NULL, z REAL NOT NULL, embedding BLOB NOT NULL, PRIMARY KEY (building, id)) WITHOUT ROWID",
)

HISTORY = "CREATE TABLE history (building INTEGER PRIMARY KEY REFERENCES building (id), data BLOB NOT NULL)"
STOREYS = "CREATE TABLE storeys (building INTEGER PRIMARY KEY REFERENCES building (id), data BLOB NOT NULL)"
TABLES = (*_TABLES_1, HISTORY, STOREYS)
# Formats that are read as they are, so that a map which can't be written to need not be migrated first.
READABLE: Mapping[int, tuple[str, ...]] = {1: _TABLES_1, 2: (*_TABLES_1, HISTORY), FORMAT_VERSION: TABLES}

SQLITE_ERRORS = (sqlite3.Error, UnicodeError)  # the second: a damaged name in the text of the first

Migration = Callable[[sqlite3.Connection], object]


def _with_storeys(connection: sqlite3.Connection) -> None:
    connection.execute(STOREYS)
    for (key,) in connection.execute("SELECT id FROM building ORDER BY id").fetchall():
        keep_storeys(connection, key)


# Version v -> what makes a file of version v + 1 of it: runs inside a transaction, must leave `TABLES` of its day.
# To change the format: raise FORMAT_VERSION and add the step from the version before.
MIGRATIONS: Mapping[int, Migration] = {
    1: lambda connection: connection.execute(HISTORY),
    2: _with_storeys,
}

T = TypeVar("T")


@contextmanager
def map_errors(path: Path) -> Iterator[None]:
    """Turn what SQLite and the file system say into one line of ours."""
    try:
        yield
    except SQLITE_ERRORS as error:
        raise MapError(_line(path, error)) from error
    except OSError as error:
        raise MapError(f"expected a map file that can be opened (got {error.strerror or error}: {path})") from error


def _line(path: Path, error: sqlite3.Error | UnicodeError) -> str:
    if isinstance(error, UnicodeError):
        return f"expected a whole map file (got a damaged one: {path}: text that is not UTF-8)"
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"expected {path} to be free within {BUSY_TIMEOUT_S:g} s (got another writer that holds it)"
    if code == sqlite3.SQLITE_FULL:
        return _no_room(path)
    if code == sqlite3.SQLITE_READONLY:
        return f"expected a map that can be written (got a read-only file or folder: {path})"
    if code == sqlite3.SQLITE_IOERR:
        return f"expected to read or write {path} (got an input/output error; the map is as it was)"
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_TOOBIG):
        return f"expected a whole map file (got a damaged one: {path}: {error})"
    if code == sqlite3.SQLITE_CANTOPEN:
        return f"expected a map file that can be opened (got {path}, or its folder, which can't be)"
    return f"expected a sound map file (got {path}: {error})"


def _no_room(path: Path) -> str:
    return f"expected room to write {path} (got a full disk; the map is as it was)"


def _crowded(path: Path) -> bool:
    """Whether nobody has the map open, and the disk is too full for what would be put beside it to open it."""
    beside = path.resolve()
    return not Path(f"{beside}-shm").exists() and shutil.disk_usage(beside.parent).free < ROOM_BYTES


def create_file(path: Path, fill: Callable[[sqlite3.Connection], None]) -> None:
    """Make a map file that appears whole or not at all.

    Args:
        path: where; nothing may be there.
        fill: writes the first rows.

    Raises:
        MapError: something is there already, or it can't be written.

    """
    with map_errors(path), scratch_folder(path) as folder:
        temporary = folder / path.name
        with closing(sqlite3.connect(temporary, isolation_level=None)) as connection:
            connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            connection.execute("PRAGMA journal_mode = WAL")  # kept in the file
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {FORMAT_VERSION}")
            for table in TABLES:
                connection.execute(table)
            fill(connection)
            connection.execute("COMMIT")
        publish_map(temporary, path)


def publish_map(temporary: Path, path: Path) -> None:
    """Give a finished map file its name, unless the name is taken.

    Raises:
        MapError: it is, by now.

    """
    if not path.exists():  # a log that outlived its map would be replayed into the new one
        for suffix in SIDECARS:
            Path(f"{path}{suffix}").unlink(missing_ok=True)
    try:
        link_new(temporary, path, str(path))
    except FileExistsError:
        raise MapError(f"expected no file at {path} (got one that is there already)") from None
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def connect_to_write(path: Path) -> sqlite3.Connection:
    """Open a map to change it; an older format is migrated first.

    Raises:
        MapError: not a map, damaged, of a format this version does not know, or not to be written.

    """
    connection = _connect(path)
    try:
        with map_errors(path):
            if _crowded(path):  # SQLite would say so too, but leave what it had begun
                raise MapError(_no_room(path))
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA temp_store = MEMORY")
            migrate(connection, path, FORMAT_VERSION, MIGRATIONS)
            check_schema(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def close_writer(connection: sqlite3.Connection) -> None:
    """Close; the last to do so leaves one file."""
    with closing(connection), suppress(sqlite3.Error):  # what is committed is safe in the log, moved or not
        connection.execute("PRAGMA busy_timeout = 0")  # readers may stay as long as they like
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def read(path: Path, work: Callable[[sqlite3.Connection], T]) -> T:
    """Do ``work`` on one consistent state of the map and hold no lock afterwards.

    Raises:
        MapError: not a map, damaged, or of another format.

    """
    for _ in range(5):
        connection, as_it_stands = _connect_to_read(path)
        with map_errors(path), closing(connection):
            before = path.stat()
            connection.execute("BEGIN")
            check_schema(connection, path, READABLE)
            try:
                result = work(connection)
            except MapError as error:
                raise MapError(f"{path}: {error}") from error
            after = path.stat()
        # Read without locks, so a writer elsewhere may have moved pages under it.
        same = (before.st_mtime_ns, before.st_size, before.st_ino) == (
            after.st_mtime_ns,
            after.st_size,
            after.st_ino,
        )
        if same or not as_it_stands:
            return result
    raise MapError(f"expected a map at rest, as it can only be read (got one that keeps changing: {path})")


def _connect_to_read(path: Path) -> tuple[sqlite3.Connection, bool]:
    """A connection that can't write, and whether it reads the bare file without locks.

    Opened to read and write all the same: a connection opened read-only could not tidy up when it is the last.
    """
    connection = _connect(path)
    log = Path(f"{path.resolve()}-wal")
    if not log.exists() and _crowded(path):
        connection.close()
        return _connect(path, "&immutable=1"), True
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        return connection, False
    except sqlite3.OperationalError as error:
        connection.close()
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL):
            raise MapError(_line(path, error)) from error
    except SQLITE_ERRORS as error:
        connection.close()
        raise MapError(_line(path, error)) from error
    if log.exists() and log.stat().st_size:
        advice = "open the map once where it can be written"
        raise MapError(f"expected no unfinished log beside a map that can only be read (got {log}: {advice})")
    return _connect(path, "&immutable=1"), True


def _connect(path: Path, options: str = "") -> sqlite3.Connection:
    with map_errors(path):
        if not path.is_file():
            found = "a folder" if path.is_dir() else "no such file" if not path.exists() else "something else"
            raise MapError(f"expected a map file (got {found}: {path})")
        with path.open("rb") as file:
            header = file.read(100)
        if len(header) < 100 or not header.startswith(b"SQLite format 3\0"):
            found = other_kind(path, MAP) or ("an empty file" if not header else "a file that is not SQLite's")
            raise MapError(f"expected a map file (got {found}: {path})")
        if int.from_bytes(header[68:72], "big") != APPLICATION_ID:
            found = other_kind(path, MAP) or "an SQLite file of something else"
            raise MapError(f"expected a map file (got {found}: {path})")
        uri = f"{path.resolve().as_uri()}?mode=rw{options}"
        connection = sqlite3.connect(uri, uri=True, timeout=BUSY_TIMEOUT_S, isolation_level=None)
        try:
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BLOB_BYTES)
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
        except BaseException:
            connection.close()
            raise
    return connection


def format_version(connection: sqlite3.Connection) -> int:
    """The file's format version."""
    version: int = connection.execute("PRAGMA user_version").fetchone()[0]
    return version


def check_schema(
    connection: sqlite3.Connection, path: Path, formats: Mapping[int, tuple[str, ...]] | None = None
) -> None:
    """Refuse a format that is none of ``formats`` (default: the present one), and tables that are not its own."""
    formats = formats if formats is not None else {FORMAT_VERSION: TABLES}
    version = format_version(connection)
    if version not in formats:
        advice = "; opening it to write migrates it" if version in MIGRATIONS else ""
        raise MapError(f"expected map format {FORMAT_VERSION} (got {version}{advice}: {path})")
    found = connection.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL LIMIT 99").fetchall()
    if sorted(sql for (sql,) in found) != sorted(formats[version]):
        raise MapError(f"expected the tables of map format {version} (got others: {path})")


def migrate(connection: sqlite3.Connection, path: Path, target: int, migrations: Mapping[int, Migration]) -> None:
    """Bring a map to format ``target``, step by step, all or nothing.

    Raises:
        MapError: it is newer, or too old for the steps there are.

    """
    if format_version(connection) == target:
        return
    with map_errors(path):
        connection.execute("BEGIN IMMEDIATE")
        try:
            first = format_version(connection)  # again: another writer may have been faster
            steps = range(first, target)
            if first > target or any(version not in migrations for version in steps):
                raise MapError(f"expected map format {target} (got {first}: {path})")
            for version in steps:
                migrations[version](connection)
                connection.execute(f"PRAGMA user_version = {version + 1}")
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
