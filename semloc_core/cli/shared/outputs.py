"""How commands say what they write: an option or argument with the parser `Writes`; the rest is done here, for all.

A command that writes anything has ``--force``, and what it is given is checked by `semloc_core.files.outputs` before
its function is called, so before it reads or computes anything.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from semloc_core.cli.shared.words import check_numbers, name
from semloc_core.files import FOLDER, Output, guarded

FORCE = "Replace what is there, if it is of the same kind; an input never."
Force = Annotated[bool, typer.Option("--force", help=FORCE)]
"""For a command whose function asks for it too; the others have it without."""

_READ = {"FILE", "MAP", "MODEL", "GRAPH", "RUN", "RESULTS", "ROOT", "STATE"}


class Writes:
    """The parser of an option or argument that names what is written.

    Args:
        kind: of `semloc_core.files.kinds`.
        in_place: what is there is gone on from.
        address: it may be a map on a server, which is no file.
        files: of a folder, the files that are written into it, given the command's other values.
        inside: kind of these.

    """

    __name__ = "path"

    def __init__(
        self,
        kind: str,
        *,
        in_place: bool = False,
        address: bool = False,
        files: Callable[[dict[str, Any]], Iterable[str]] = lambda values: (),
        inside: str = FOLDER,
    ) -> None:
        self.kind, self.in_place, self.address, self.files, self.inside = kind, in_place, address, files, inside

    def __call__(self, value: str | Path) -> Any:
        """What the function gets: a path; an address as it is."""
        return str(value) if self.address else Path(value)

    def outputs(self, name: str, value: Any, values: dict[str, Any]) -> Iterator[Output]:
        """What a value makes the command write, given all its values."""
        if not (self.address and "://" in str(value)):
            yield Output(name, Path(value), self.kind, self.in_place)
            yield from (Output(name, Path(value) / file, self.inside, inside=True) for file in self.files(values))


def output_option(metavar: str, kind: str, help: str, **how: Any) -> Any:
    """``-o``, ``--output``: what a command writes; ``how`` as of `Writes`."""
    return typer.Option("-o", "--output", metavar=metavar, parser=Writes(kind, **how), help=help)


def writes(parameter: Any) -> Writes | None:
    """How an option or argument says that it is written."""
    described = getattr(parameter, "type_descriptor", None)  # of newer typers; click's type before
    how = described.parameter_info.parser if described is not None else getattr(parameter.type, "func", None)
    return how if isinstance(how, Writes) else None


def is_read(parameter: Any) -> bool:
    """Whether an option or argument names what is read: a path, or words among which a path may be."""
    if writes(parameter) is not None:
        return False
    words = set(re.split(r"\W+", str(parameter.metavar or "")))
    described = getattr(parameter, "type_descriptor", None)
    kind = str(described.annotation) if described is not None else type(parameter.type).__name__
    return "Path" in kind or bool(words & _READ)


def _force_option() -> Any:
    """``--force`` as typer makes it."""

    def made(force: Force = False) -> None:
        pass

    own = typer.Typer(add_completion=False)
    own.command()(made)
    return next(parameter for parameter in get_command(own).params if parameter.name == "force")


class _Guarded:
    """A command whose numbers and outputs are checked before it is called."""

    params: list[Any]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._asked = all(parameter.name != "force" for parameter in self.params)
        if self._asked and any(map(writes, self.params)):
            self.params.append(_force_option())

    def invoke(self, ctx: Any) -> Any:
        """Check, then call."""
        check_numbers(self.params, ctx.params)
        force = bool(ctx.params.pop("force", False) if self._asked else ctx.params["force"])
        outputs: list[Output] = []
        inputs: list[Path] = []
        for parameter in self.params:
            value, how = ctx.params.get(parameter.name or ""), writes(parameter)
            if how is not None and value is not None:
                outputs += how.outputs(name(parameter), value, ctx.params)
            elif is_read(parameter) and value:
                inputs += [Path(each) for each in (value if isinstance(value, (list, tuple)) else [value])]
        with guarded(outputs, inputs, force=force):
            return super().invoke(ctx)  # type: ignore[misc]  # of the class beside it


class Command(_Guarded, TyperCommand):
    """A command."""


class Group(_Guarded, TyperGroup):
    """A group of commands, which may do something itself."""


class App(typer.Typer):
    """Commands that are all guarded."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"cls": Group} | options)

    def command(self, name: str | None = None, **options: Any) -> Callable[[Any], Any]:
        """As typer's."""
        return super().command(name, **{"cls": Command} | options)
