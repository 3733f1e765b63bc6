"""Every command's options, gone through: whatever names an output says so, and so is checked by the one rule."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from typer.main import get_command

from semloc_core.cli.commands import app
from semloc_core.cli.shared.outputs import Command, Group, is_read, writes

READ = {
    *("--map", "--run", "--study", "--synonyms", "--labelspace", "--query-labels", "--model", "--start"),
    *("--distractors", "--grid", "--homes"),
}
"""Options that name what is read. A new option that takes a path is declared with `Writes`, or listed here."""
READ_ARGUMENTS = {
    *("GRAPH", "GRAPH...", "GRAPH|MAP", "GRAPH|RUN", "[GRAPH|RUN]", "GRAPH|RUN...", "RUN", "RESULTS", "[GRAPH]"),
    *("MAP", "MAP|URL", "ROOT", "[ROOT]", "FILE", "MAP.yaml", "OBJECTS"),
}
FILES = re.compile(r"FILE|FOLDER|HTML|PNG|MODEL|GRAPH|RUN|MAP|RESULTS|ROOT|STATE")


def commands(command: Any, name: str = "semloc") -> Iterator[tuple[str, Any]]:
    yield name, command
    for word, below in getattr(command, "commands", {}).items():
        yield from commands(below, f"{name} {word}")


ALL = dict(commands(get_command(app)))
PARAMETERS = [(name, one) for name, command in ALL.items() for one in command.params]


def test_every_command_is_guarded() -> None:
    assert len(ALL) > 30
    assert not [name for name, command in ALL.items() if not isinstance(command, (Command, Group))]


def test_what_is_not_declared_as_written_is_known_to_be_read() -> None:
    """A new output that is not declared is found here: it is on neither list."""
    declared = [(name, one.name) for name, one in PARAMETERS if writes(one) is not None]
    for name, one in PARAMETERS:
        if writes(one) is not None:
            continue
        if not (is_read(one) or FILES.search(str(one.metavar))):
            assert "path" not in kind(one).lower(), (name, one.name)
        elif one.param_type_name == "option":
            assert READ & {*one.opts}, (name, one.name)
        else:
            assert one.metavar in READ_ARGUMENTS, (name, one.name)
    assert {("semloc map build", "output"), ("semloc map pull", "map_file"), ("semloc world many", "root")} <= {
        *declared
    }
    assert len(declared) > 25


@pytest.mark.parametrize("name", sorted(ALL))
def test_whoever_writes_has_force_and_only_they(name: str) -> None:
    parameters = ALL[name].params
    forced = any("--force" in one.opts for one in parameters)
    assert forced == any(writes(one) is not None for one in parameters)


def kind(parameter: Any) -> str:
    described = getattr(parameter, "type_descriptor", None)
    return str(described.annotation) if described is not None else f"{type(parameter.type).__name__}{parameter.type}"
