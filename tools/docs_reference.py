"""The pages of the reference, as Markdown, out of the code that they are about."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import msgspec
import typer

import semloc_core
from semloc_core.cli.commands import HELP, app
from semloc_core.config import LocaliserConfig, options
from semloc_core.sources import SimulationConfig, StreamConfig
from semloc_core.wire.messages import MESSAGES
from semloc_core.wire.schemas import schema_text

ROOT = Path(__file__).resolve().parents[1]
NODES = {
    "localiser": ("parameters.py", "NodeConfig"),
    "scene_graph_player": ("player.py", "PlayerConfig"),
    "hydra_bridge": ("hydra_bridge.py", "BridgeConfig"),
    "detections_bridge": ("detections_bridge.py", "BridgeConfig"),
}
"""Nodes -> where the parameters of their own are: file in `semloc_ros`, class."""
EXAMPLES = {"scene_graph_update": "full", "place_matches": "pose", "class_attributions": "attention"}
"""Messages -> the example in `msgs_schema` that is shown; of others the first."""


def _cell(text: object) -> str:
    """Text as a cell of a table: in one line, with its bars told from the table's."""
    return " ".join(str(text).split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines) + "\n"


# -- commands ---------------------------------------------------------------------------------------------------------


def commands(command: Any = None, path: str = "semloc") -> Iterator[tuple[str, Any]]:
    """Every command of the command line that does something by itself, by its words."""
    command = command or typer.main.get_command(app)
    inside = getattr(command, "commands", None)
    if inside is None:
        yield path, command
    for name, one in (inside or {}).items():
        yield from commands(one, f"{path} {name}")


def _value(option: Any) -> str:
    """What an option takes, as its help names it."""
    if option.is_flag:
        return ""
    if option.metavar:
        return str(option.metavar)
    kind = option.type_descriptor.annotation
    while get_origin(kind) not in (None, Literal):
        kind = get_args(kind)[0]
    return "\\|".join(map(str, get_args(kind))) or getattr(kind, "__name__", str(kind))


def _option(option: Any) -> tuple[str, str, str]:
    names = sorted(option.opts, key=len, reverse=True) + option.secondary_opts
    shown = option.default not in (None, False, (), [], "") and not option.required and not option.is_flag
    default = option.default if isinstance(option.default, str | int | float | Path) else ""
    words = _value(option)
    takes = f" {words}" if words else ""
    return (
        ", ".join(f"`{name}`" for name in names) + takes,
        "required" if option.required else (f"`{default}`" if shown and default != "" else ""),
        _cell(option.help or ""),
    )


def command_page() -> str:
    """`semloc COMMAND --help` of every command."""
    ending = next(part for part in HELP.split("\n\n") if part.startswith("Exit status"))
    parts = [
        "# Commands\n\nAs `semloc COMMAND --help` has them. Every `--json FILE` writes the figures that are printed.\n",
        f"{ending.rstrip()}\n",
    ]
    for path, command in commands():
        named = [one for one in command.params if one.param_type_name == "argument"]
        usage = " ".join(str(one.metavar or one.name.upper()) for one in named)
        found = [one for one in command.params if one.param_type_name == "option" and not one.hidden]
        parts.append(f"## {path}\n\n```text\n{path} [OPTIONS] {usage}".rstrip() + "\n```\n")
        parts.append(re.sub(r"^ +", "", str(command.help or "").split("\f")[0], flags=re.MULTILINE) + "\n")
        if named:
            parts.append("\n".join(f"- `{one.metavar or one.name.upper()}`: {_cell(one.help)}" for one in named) + "\n")
        if found:
            parts.append(_table(("option", "default", ""), [_option(one) for one in found]))
    return "\n".join(parts)


# -- parameters -------------------------------------------------------------------------------------------------------


def node_struct(file: str, name: str) -> type[msgspec.Struct]:
    """A struct of options out of a file of `semloc_ros`, read without ROS.

    Args:
        file: its name in the package.
        name: the class; it may extend classes of `semloc_core`.

    """
    tree = ast.parse((ROOT / "semloc_ros" / "semloc_ros" / file).read_text(encoding="utf-8"))
    found = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name)
    words: dict[str, Any] = {
        "Annotated": Annotated, "Literal": Literal, "Meta": msgspec.Meta, "msgspec": msgspec,
        "StreamConfig": StreamConfig, "__name__": "semloc_ros.options",
    }  # fmt: skip
    exec(compile(ast.Module([found], []), file, "exec", dont_inherit=True), words)
    made: type[msgspec.Struct] = words[name]
    return made


def _range(option: Any) -> str:
    if option.choices:
        return ", ".join(f"`{one}`" for one in option.choices)
    if option.type is bool:
        return "`true`, `false`"
    if option.minimum is None and option.maximum is None:
        return {str: "text", tuple: "list of text"}.get(option.type, option.type.__name__)
    low = "" if option.minimum is None else f"{option.minimum:g} "
    return f"{low}… {'' if option.maximum is None else f'{option.maximum:g}'}".strip()


def _parameters(struct: type[msgspec.Struct]) -> str:
    rows = []
    for one in options(struct):
        default = json.dumps(one.default, ensure_ascii=False)
        rows.append((f"`{one.name}`", f"`{default}`", _range(one), _cell(one.description)))
    return _table(("name", "default", "range", ""), rows)


def parameter_page() -> str:
    """Options of the localiser and parameters of the nodes."""
    parts = [
        "# Parameters\n\n`ros2 param describe NODE NAME` says the same. Values out of their range are refused.\n",
        "## Localiser\n\n`LocaliserConfig` in Python, parameters of the node, most also options of `semloc replay`.\n",
        _parameters(LocaliserConfig),
    ]
    besides = {"scene_graph_player": SimulationConfig}
    for node, (file, name) in NODES.items():
        parts.append(f"## The node {node}\n\n" + ("Besides the above:\n" if node == "localiser" else ""))
        parts.append(_parameters(node_struct(file, name)))
        if node in besides:
            parts.append("Of the walk through a graph:\n\n" + _parameters(besides[node]))
    return "\n".join(parts)


# -- messages ---------------------------------------------------------------------------------------------------------


def _type(schema: dict[str, Any]) -> str:
    """A property's type in words."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_type(one) for one in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{one}`" for one in schema["enum"])
    if schema.get("type") == "array":
        inside = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        return f"list of {_type(inside) if isinstance(inside, dict) else 'values'}"
    if "additionalProperties" in schema and isinstance(schema["additionalProperties"], dict):
        return f"text → {_type(schema['additionalProperties'])}"
    return str(schema.get("type", "any"))


def _fields(schema: dict[str, Any]) -> str:
    need = schema.get("required", ())
    rows = [
        (f"`{name}`", _type(one), "" if name in need else f"`{json.dumps(one.get('default'))}`")
        for name, one in schema.get("properties", {}).items()
    ]
    return _table(("field", "type", "default"), rows)


def message_page() -> str:
    """The messages: what each is, its fields, an example, its schema."""
    parts = [
        "# Messages\n\nJSON, in `std_msgs/String`. Lengths are metres, angles radians, stamps nanoseconds; ids "
        "are text. A field without a default is required. The schemas, with examples valid and not, are in "
        "`msgs_schema/`.\n"
    ]
    shared: dict[str, dict[str, Any]] = {}
    for name, type_ in MESSAGES.items():
        text = schema_text(type_)
        schema = json.loads(text)
        shared |= schema.get("$defs", {})
        valid = ROOT / "msgs_schema" / name / "valid"
        example = valid / f"{EXAMPLES[name]}.json" if name in EXAMPLES else min(valid.glob("*.json"))
        parts += [
            f"## {name}\n\n{schema['description'].replace('``', '`')}\n",
            _fields(schema),
            f'??? example "{example.stem}"\n\n' + _indented("json", example.read_text(encoding="utf-8")),
            '??? note "schema"\n\n' + _indented("json", text),
        ]
    parts.append("## Parts of messages\n")
    for name in sorted(shared):
        parts += [f"### {name}\n\n{shared[name].get('description', '').replace('``', '`')}\n", _fields(shared[name])]
    return "\n".join(parts)


def _indented(kind: str, text: str) -> str:
    lines = [f"```{kind}", *text.rstrip().splitlines(), "```"]
    return "\n".join(f"    {line}" for line in lines) + "\n"


# -- Python -----------------------------------------------------------------------------------------------------------


def python_page() -> str:
    """What `semloc_core` exports, each described by mkdocstrings where it is defined."""
    parts = ["# Python\n\nWhat `from semloc_core import …` gives; [programs that use it](../python.md).\n"]
    untitled = "{show_root_heading: false, show_root_toc_entry: false}"
    for name in semloc_core.__all__:
        found = getattr(semloc_core, name)
        parts.append(f"## {name}\n\n::: {found.__module__}.{found.__qualname__}\n    options: {untitled}\n")
    return "\n".join(parts)


PAGES = {
    "reference/commands.md": command_page,
    "reference/parameters.md": parameter_page,
    "reference/messages.md": message_page,
    "reference/python.md": python_page,
}
"""Address in the site -> what writes the page."""
