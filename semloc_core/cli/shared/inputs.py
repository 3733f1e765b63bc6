"""Inputs are looked for before anything is imported that takes seconds: a file that is missing is said at once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import typer

from semloc_core.cli.shared.ending import working
from semloc_core.cli.shared.outputs import Writes
from semloc_core.errors import ConfigError, FileFormatError, MapError, SemlocError

WHAT: dict[str, tuple[str, type[SemlocError]]] = {
    "GRAPH": ("a scene-graph file", FileFormatError),
    "GRAPH...": ("a scene-graph file", FileFormatError),
    "GRAPH|RUN": ("a scene-graph file or a run", FileFormatError),
    "GRAPH|MAP": ("a scene-graph file or a map", FileFormatError),
    "GRAPH|RUN...": ("a scene-graph file or a run", FileFormatError),
    "[GRAPH|RUN]": ("a scene-graph file or a run", FileFormatError),
    "[GRAPH]": ("a scene graph", FileFormatError),
    "RUN": ("a bag", FileFormatError),
    "MAP.yaml": ("a map of nav2", FileFormatError),
    "OBJECTS": ("a list of objects", FileFormatError),
    "RESULTS": ("a bag", FileFormatError),
    "MAP": ("a map file", MapError),
    "MAP|URL": ("a map file", MapError),
    "ROOT": ("a folder of buildings", FileFormatError),
    "[ROOT]": ("a folder of buildings", FileFormatError),
    "DIR": ("a folder of buildings", FileFormatError),
    "FILE": ("a file", FileFormatError),
    "FILE|auto": ("a file", FileFormatError),
    "MODEL": ("a model file", FileFormatError),
    "MODEL|general": ("a model file", FileFormatError),
}
"""What an input is, by the word that stands for it in the help, and the error that its absence is."""
OPTIONS = ("--map", "--run", "--study", "--synonyms", "--query-labels", "--model", "--grid", "--distractors")
"""Options that name inputs; a small word of their metavar stands for no file."""


def guard(app: typer.Typer) -> None:
    """Let all commands look for their inputs first, and be stoppable in good order."""
    for group in app.registered_groups:
        assert group.typer_instance is not None
        guard(group.typer_instance)
        if callback := group.typer_instance.registered_callback:
            callback.callback = _guarded(callback.callback)
    for command in app.registered_commands:
        command.callback = _guarded(command.callback)


def _guarded(function: Callable[..., Any] | None) -> Callable[..., Any] | None:
    if function is None or hasattr(function, "__wrapped__"):
        return function

    @functools.wraps(function)
    def run(**values: Any) -> Any:
        with working():
            for metavar, paths in _inputs(function, values):
                for path in paths:
                    _look_for(path, metavar)
            return function(**values)

    return run


def _inputs(function: Callable[..., Any], values: dict[str, Any]) -> Iterable[tuple[str, Sequence[Any]]]:
    """The word for each input, and the paths given."""
    from typing import get_type_hints

    for parameter, hint in get_type_hints(function, include_extras=True).items():
        value = values.get(parameter)
        for said in getattr(hint, "__metadata__", ()):
            if value is None or said.metavar not in WHAT:
                continue
            if isinstance(said.parser, Writes):
                continue
            asked = isinstance(said, typer.models.ArgumentInfo)
            if asked or any(option in OPTIONS for option in getattr(said, "param_decls", None) or ()):
                yield said.metavar, value if isinstance(value, list | tuple) else [value]


def _look_for(path: Any, metavar: str) -> None:
    what, error = WHAT[metavar]
    if "://" in str(path) or str(path) in metavar.split("|")[1:]:
        return
    if not Path(path).exists():
        raise error(f"expected {what} (got no such file: {path})")
    if metavar.strip("[]") in ("ROOT", "DIR") and not Path(path).is_dir():
        raise ConfigError(f"expected {what} (got {path}, which is a file)")
