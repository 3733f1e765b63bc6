"""A page kept in a file, to be put into another page later: a study takes long, its page does not."""

from __future__ import annotations

from pathlib import Path

import msgspec

from semloc_core.errors import FileFormatError
from semloc_core.files import write_whole
from semloc_core.report.page import Page

FORMAT = "semloc/page/1"


class _Kept(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    format: str
    page: Page


def keep(page: Page, path: Path) -> None:
    """Write a page's content as JSON."""
    write_whole(path, msgspec.json.encode(_Kept(FORMAT, page)) + b"\n")


def kept(path: Path) -> Page:
    """Read what `keep` wrote.

    Raises:
        FileFormatError: no such file, or another kind of file.

    """
    expected = f"expected a page kept by semloc introspect --keep ({FORMAT})"
    try:
        found = msgspec.json.decode(path.read_bytes(), type=_Kept)
    except FileNotFoundError as error:
        raise FileFormatError(f"{expected} (got {path}, which does not exist)") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{expected} (got {path}: {error})") from error
    if found.format != FORMAT:
        raise FileFormatError(f"{expected} (got {path}: {found.format})")
    return found.page
