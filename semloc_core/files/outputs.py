"""One rule for every file that a command writes, checked before anything is read or computed.

An output is refused where it is an input, whatever name either goes by; where two outputs are one; where something
of another kind is there, an empty file apart; and, without ``--force``, where anything is there. Pipes, terminals and
``/dev/stdout`` take what comes. Whatever another process writes there after the check stays: see
`semloc_core.files`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from semloc_core.errors import ConfigError
from semloc_core.files.kinds import BAG, EMPTY, FOLDER, MAP, STATE, kind_of
from semloc_core.files.whole import Seen, claimed, descriptor, is_stream, real, seen

_BESIDE = ("-wal", "-shm", "-journal")
"""What SQLite keeps beside a map or a bag."""
_NO_STREAM = {
    MAP: "where a map can't be written to and fro",
    STATE: "where a training state can't be kept",
    FOLDER: "which is no folder",
}
"""Kinds that no pipe, terminal or device takes, and why."""


@dataclass(frozen=True)
class Output:
    """A file or folder that a command is to write.

    Args:
        name: of the option, for errors.
        path: where.
        kind: of `semloc_core.files.kinds`; `FOLDER`: a folder to put files into.
        in_place: what is there is gone on from, so that it needs no ``--force``.
        inside: it is put into a folder that is an output itself, and made where it is missing.

    """

    name: str
    path: Path
    kind: str
    in_place: bool = False
    inside: bool = False


@contextmanager
def guarded(outputs: Sequence[Output], inputs: Iterable[Path], *, force: bool) -> Iterator[None]:
    """Check outputs by the rule, and watch over them while the block runs.

    Args:
        outputs: of the command.
        inputs: files and folders that it reads.
        force: what is there, of the same kind, may be replaced.

    Raises:
        ConfigError: the rule forbids one of them.

    """
    read = _Inputs(inputs)
    claims: dict[str, Seen | None] = {}
    for one in outputs:
        _check(one, read, force)
    _check_apart([one for one in outputs if not is_stream(one.path)])
    for one in outputs:
        if one.kind != FOLDER and not is_stream(one.path):
            claims[real(one.path)] = seen(one.path)
    token = claimed.set(claims)
    try:
        yield
    finally:
        claimed.reset(token)


class _Inputs:
    """Files that are read, by what they are and not by their names."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self.bags: dict[str, Path] = {}
        self._files: dict[tuple[int, int], Path] = {}
        self._names: dict[str, Path] = {}
        for path in paths:
            if path.is_dir() and kind_of(path) == BAG:
                self.bags[real(path)] = path
            for file in (path, *_files_in(path)):
                self._names[real(file)] = path
                self._names |= {real(file) + end: path for end in _BESIDE}
                if (found := _identity(file)) is not None:
                    self._files[found] = path

    def holding(self, path: Path) -> Path | None:
        """The input that an output is, or would change."""
        name = real(path)
        found = self._names.get(name) or self._files.get(_identity(path) or (-1, -1))
        within = (bag for folder, bag in self.bags.items() if Path(name).is_relative_to(folder))
        return found or next(within, None)

    def under(self, folder: Path) -> Path | None:
        """An input that lies in a folder which an output is to be."""
        name = Path(real(folder))
        return next((path for each, path in self._names.items() if Path(each).is_relative_to(name)), None)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _files_in(path: Path) -> Iterator[Path]:
    """Files that are read of a folder: of a bag, or of buildings."""
    if path.is_dir():
        if kind_of(path) == BAG:
            yield from path.iterdir()
        yield from (each for name in ("map", "query") for each in path.glob(f"*/{name}.json"))


def _check(one: Output, inputs: _Inputs, force: bool) -> None:
    path, stream = one.path, is_stream(one.path)
    if stream and one.kind in _NO_STREAM:
        raise ConfigError(f"expected {one.name} to be a file or folder of its own (got {path}, {_NO_STREAM[one.kind]})")
    if stream and (descriptor(path) is None or not path.is_file()):
        return
    holding = inputs.holding(path)
    if holding is None and path.is_dir() and one.kind == BAG:
        holding = inputs.under(path)
    if one.kind not in (BAG, FOLDER) and path.is_dir() and real(path) not in inputs.bags:
        holding = None  # a folder, which is said below
    if holding is not None and not (one.kind == FOLDER and path.is_dir() and real(path) not in inputs.bags):
        raise ConfigError(f"expected {one.name} to be no input (got {path}, {_role(path, holding)})")
    if stream:
        return
    folders = one.kind == FOLDER or (one.kind == BAG and path.suffix != ".mcap")
    if folders:
        if path.is_dir() and (one.kind == FOLDER or not any(path.iterdir())):
            return
    elif path.is_dir():
        raise ConfigError(f"expected a file to write to (got {path}, which is a folder)")
    elif not path.parent.is_dir() and not one.inside:
        raise ConfigError(f"expected a file in a folder that exists (got {path})")
    for end in _BESIDE:
        if real(path).endswith(end) and Path(real(path).removesuffix(end)).is_file():
            raise ConfigError(f"expected {one.name} to be a file of its own (got {path}, a part of the file beside it)")
    if not path.exists():
        return
    found = kind_of(path)
    if found not in (one.kind, EMPTY) or (found == BAG and path.is_dir() != folders):
        raise ConfigError(f"expected {one.name} to be new, or {one.kind} (got {path}, which is {found})")
    if not (force or (one.in_place and found == one.kind)):
        raise ConfigError(f"expected a new file, or --force to replace one (got {path}, which exists)")


def _role(path: Path, holding: Path) -> str:
    """How an output is an input, or in one."""
    if path == holding:
        return "which is read"
    return f"a part of {holding}, which is read" if holding.is_dir() else f"which is {holding}, which is read"


def _check_apart(outputs: Sequence[Output]) -> None:
    """Refuse two outputs that are one, or one inside another's bag."""
    names: dict[object, Output] = {}
    bags = [(real(one.path), one) for one in outputs if one.kind == BAG and one.path.suffix != ".mcap"]
    for one in outputs:
        name = real(one.path)
        clash = next((bag for folder, bag in bags if bag is not one and Path(name).is_relative_to(folder)), None)
        if one.kind != FOLDER:
            for key in (name, _identity(one.path)):
                if key is not None and names.setdefault(key, one) is not one:
                    clash = names[key]
        if clash is not None:
            raise ConfigError(
                f"expected {clash.name} and {one.name} to be files of their own (got {one.path} for both)"
            )
