"""Files that are there whole or not at all: a full disk or a kill leaves the earlier one.

What is written stands under a name of its own beside the file until it is done. Where a command has claimed a file
(`semloc_core.files.outputs`), it is put in place only of what was there when the command began: of two processes that
write the same file, the one that is done later says so, and the other's file stays.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, NamedTuple

_DESCRIPTOR = re.compile(r"/dev/(?:fd/(\d+)|std(in|out|err))|/proc/(?:self|thread-self|\d+)/fd/(\d+)")


class Seen(NamedTuple):
    """What tells a file from one that has been written since; of a map, its log too."""

    device: int
    inode: int
    size: int
    changed_ns: int
    log: tuple[int, int] | None


claimed: ContextVar[dict[str, Seen | None] | None] = ContextVar("claimed", default=None)
"""What was at each path that the running command may write, by real path; None: nothing. Set by `outputs.guarded`."""


def real(path: str | Path) -> str:
    """A path without links; unlike `Path.resolve`, with a way out of a loop of them."""
    return os.path.realpath(path)


def seen(path: str | Path) -> Seen | None:
    """What is there now; None: nothing."""
    try:
        now = Path(path).stat()
    except OSError:
        return None
    try:
        log = Path(f"{real(path)}-wal").stat()
    except OSError:
        return Seen(now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns, None)
    beside = (log.st_size, log.st_mtime_ns) if log.st_size else None  # whoever reads a map makes an empty one
    return Seen(now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns, beside)


def descriptor(path: str | Path) -> int | None:
    """The open file that a path such as ``/dev/stdout`` means."""
    found = _DESCRIPTOR.fullmatch(str(path))
    if found is None:
        return None
    number, name, other = found.groups()
    return int(number or other) if name is None else ("in", "out", "err").index(name)


def is_stream(path: str | Path) -> bool:
    """Whether a path is a pipe, a terminal or another device that takes bytes, or stdout, whatever that is."""
    if descriptor(path) is not None:
        return True
    try:
        mode = Path(path).stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def open_stream(path: str | Path) -> IO[bytes]:
    """Open a path that `is_stream`; one that is open already goes on where it is."""
    number = descriptor(path)
    return Path(path).open("wb") if number is None else os.fdopen(os.dup(number), "wb")


def beside(target: str | Path) -> Path:
    """A name in the same folder that no other process takes."""
    path = Path(target)
    return path.with_name(f".{path.name[:60]}.{secrets.token_hex(8)}.tmp")


@contextmanager
def scratch_folder(target: str | Path) -> Iterator[Path]:
    """A new folder beside a file, gone with all that is in it when the block ends, however it does."""
    folder = beside(real(target))
    try:
        folder.mkdir()
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def check_claim(path: str | Path) -> None:
    """Refuse a file that the running command has claimed and another process has written since.

    Raises:
        FileExistsError: it has.

    """
    claims = claimed.get()
    if claims is not None and real(path) in claims and claims[real(path)] != seen(path):
        raise FileExistsError(errno.EEXIST, "another process has written it meanwhile", str(path))


def must_be_new(path: str | Path) -> bool:
    """Whether nothing was at a path when the running command claimed it."""
    claims = claimed.get()
    return claims is not None and claims.get(real(path), ()) is None


def replaces(path: str | Path) -> bool:
    """Whether the running command has claimed a path for what takes the place of something there."""
    claims = claimed.get()
    return claims is not None and claims.get(real(path)) is not None and not is_stream(path)


def publish(temporary: str | Path, target: str | Path) -> None:
    """Give what is whole its name, in place of what was there when the running command claimed it.

    Raises:
        FileExistsError: another process has written it since.
        OSError: it can't be renamed.

    """
    claims, name = claimed.get(), real(target)
    ours = claims is not None and name in claims
    check_claim(target)
    if ours and claims is not None and claims[name] is None and Path(temporary).is_file():
        link_new(temporary, name, str(target))
    elif Path(name).is_dir():  # a folder takes no other's place in one step
        old = beside(name)
        Path(name).rename(old)
        Path(temporary).rename(name)
        remove(old)
    else:
        Path(temporary).replace(name)
    written(target)


def remove(path: str | Path) -> None:
    """Remove a file or a folder, if it is there."""
    if Path(path).is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        Path(path).unlink(missing_ok=True)


def link_new(temporary: str | Path, name: str | Path, said: str) -> None:
    """Give a file a name that nothing has; unlike a rename this never replaces.

    Raises:
        FileExistsError: something has it.

    """
    try:
        os.link(temporary, name)
    except FileExistsError:
        raise FileExistsError(errno.EEXIST, "another process has written it meanwhile", said) from None
    except OSError:  # a file system without hard links
        if os.path.lexists(name):
            raise FileExistsError(errno.EEXIST, "another process has written it meanwhile", said) from None
        Path(temporary).replace(name)
    else:
        Path(temporary).unlink()


def written(path: str | Path) -> None:
    """What is there now is the running command's own."""
    claims = claimed.get()
    if claims is not None and real(path) in claims:
        claims[real(path)] = seen(path)


def write_whole(path: str | Path, data: bytes) -> None:
    """Write a file under another name beside it and, when it is on the disk, rename it into place.

    What is no regular file (a pipe, a terminal) is written to as it is.

    Raises:
        OSError: it can't be written; a file that was there before is as it was.

    """
    if is_stream(path):
        with open_stream(path) as stream:
            stream.write(data)
        return
    target = Path(real(path))
    temporary = beside(target)
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        publish(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)
        raise
