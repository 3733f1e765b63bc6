"""What kind of bag a file is, by its first bytes; files compressed as a whole are unpacked."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Literal, cast

from semloc_core.errors import BagError
from semloc_core.files import APPLICATION_ID

Kind = Literal["mcap", "db3", "zstd", "lz4"]
_BEGINNINGS: dict[bytes, Kind] = {
    b"\x89MCAP0\r\n": "mcap",
    b"SQLite format 3\x00": "db3",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x04\x22\x4d\x18": "lz4",
}
_HEADER_BYTES, _APPLICATION = 72, slice(68, 72)
"""Of a SQLite file, and where in it stands whose it is."""
MAX_UNPACKED_BYTES = 2**36
_PIECE = 2**20


def kind_of(path: Path) -> Kind | None:
    """The kind of a bag's file; None where it is none (a map is no bag, though of SQLite), or can't be read."""
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_BYTES)
    except OSError:
        return None
    if int.from_bytes(start[_APPLICATION], "big") == APPLICATION_ID:
        return None
    return next((kind for beginning, kind in _BEGINNINGS.items() if start.startswith(beginning)), None)


@contextmanager
def unpacked(path: Path) -> Iterator[tuple[Path, bool]]:
    """A file without its compression, if it has one, for as long as the ``with`` block lasts.

    Yields:
        The path of what was in it, and whether it was cut off.

    Raises:
        BagError: it can't be read or decompressed, or holds more than `MAX_UNPACKED_BYTES`.

    """
    kind = kind_of(path)
    if kind not in ("zstd", "lz4"):
        yield path, False
        return
    with tempfile.TemporaryDirectory() as folder:
        whole, cut_off = Path(folder) / path.stem, False
        try:
            with path.open("rb") as packed, whole.open("wb") as out:
                cut_off = _unpack(kind, packed, out, path)
        except OSError as error:
            raise BagError(f"expected room to unpack {path} (got {error.strerror or error})") from error
        yield whole, cut_off


def _unpack(kind: str, packed: IO[bytes], out: IO[bytes], path: Path) -> bool:
    """Decompress as far as it goes; whether that was not to the end."""
    stream: Any
    if kind == "zstd":
        import zstandard

        stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
    else:
        import lz4.frame  # type: ignore[import-untyped]  # ships no types

        stream = lz4.frame.open(packed, "rb")
    total = 0
    while True:
        try:
            piece = cast(bytes, stream.read(_PIECE))
        except OSError:
            raise
        except Exception as error:
            # zstandard and lz4 raise errors of their own, RuntimeError and EOFError.
            if total:
                return True
            raise BagError(f"expected a file in {kind} (got {path}: {error})") from error
        if not piece:
            return False
        total += len(piece)
        if total > MAX_UNPACKED_BYTES:
            raise BagError(f"expected at most {MAX_UNPACKED_BYTES} bytes in {path} (got more)")
        out.write(piece)
