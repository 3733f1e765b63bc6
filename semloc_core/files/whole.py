"""Files that are there whole or not at all: a full disk or a kill leaves the earlier one."""

from __future__ import annotations

import os
from pathlib import Path


def write_whole(path: str | Path, data: bytes) -> None:
    """Write a file under another name beside it and, when it is on the disk, rename it into place.

    What is no regular file (a pipe, a terminal) is written to as it is.

    Raises:
        OSError: it can't be written; a file that was there before is as it was.

    """
    target = Path(os.path.realpath(path))  # not Path.resolve, which knows no way out of a loop of links
    if target.exists() and not target.is_file():
        target.write_bytes(data)
        return
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)
        raise
