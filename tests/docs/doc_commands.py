"""Whether a command that the docs show is one that there is, without running it."""

from __future__ import annotations

import re
import shlex
from functools import cache
from typing import Any

import typer
from doc_blocks import ROOT

from semloc_core.cli.commands import app

UNSAID = {"MissingParameter", "NoArgsIsHelpError"}
"""What running text may leave out, and a block may not."""
_MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
_NODES = (ROOT / "semloc_ros" / "setup.py").read_text(encoding="utf-8")
_PARAMETERS = "\n".join(
    path.read_text(encoding="utf-8")
    for folder in ("semloc_ros/semloc_ros", "semloc_core/sources", "semloc_core/config.py")
    for path in ([ROOT / folder] if folder.endswith(".py") else (ROOT / folder).rglob("*.py"))
)


def commands_of(line: str) -> list[list[str]]:
    """The commands of a line, each as a shell splits it, up to where its output goes."""
    found: list[list[str]] = [[]]
    for word in shlex.split(line, comments=True):
        if word in ("&&", "||", "|", ";", "&"):
            found.append([])
        else:
            found[-1].append(word)
    cut = [words[: words.index(">")] if ">" in words else words for words in found]
    return [words for words in cut if words]


def fault(line: str, *, whole: bool) -> str | None:
    """What is wrong with the commands of a line; None if nothing can be said against them.

    Args:
        line: as it is typed.
        whole: it is a line of a block, so nothing that it needs may be left out.

    """
    return next(filter(None, (_fault(words, whole) for words in commands_of(line))), None)


def _fault(words: list[str], whole: bool) -> str | None:
    words = [word for word in words if word != "…"]
    while words and re.fullmatch(r"\w+=\S*", words[0]):  # variables in front
        words = words[1:]
    if not words or re.search(r"[A-Z]{3,}|\*|…", " ".join(words[:2])):
        return None  # a placeholder
    if words[0] == "semloc":
        return _semloc(words[1:], whole)
    if words[0] == "make":
        targets = [word for word in words[1:] if "=" not in word]
        return next((f"no target {one}" for one in targets if f"\n{one}:" not in _MAKEFILE), None)
    if words[:2] in (["ros2", "run"], ["ros2", "launch"]) and words[2:3] == ["semloc_ros"]:
        return _ros(words[1:])
    if words[0] in ("pytest", "sh", "bash", "python", "python3") and len(words) > 1:
        return _script(words)
    return None


@cache
def _command() -> Any:
    return typer.main.get_command(app)


def _semloc(words: list[str], whole: bool) -> str | None:
    command = _command()
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    if hasattr(command, "commands"):
        options = {option for one in command.params for option in one.opts}
        return None if set(words) <= options | {"--help"} else f"no command {words[0]}"
    try:
        command.make_context("semloc", [word for word in words if word != "--help"])
    except Exception as error:  # of click, or of typer's own copy of it
        if type(error).__name__ in UNSAID and not whole:
            return None
        said = getattr(error, "format_message", lambda: "")()
        if not whole and "requires an argument" in said:
            return None
        return said or repr(error)
    return None


def _script(words: list[str]) -> str | None:
    if words[1] == "-m":
        path = words[2].replace(".", "/")
        there = not words[2].startswith("semloc") or any(
            (ROOT / found).exists() for found in (f"{path}.py", f"{path}/__main__.py")
        )
        return None if there else f"no module {words[2]}"
    paths = [word for word in words[1:] if "/" in word and not word.startswith(("-", "$", "/", ".venv"))]
    return next((f"no {one}" for one in paths if not (ROOT / one.split("::")[0]).exists()), None)


def _ros(words: list[str]) -> str | None:
    verb, name = words[0], words[2]
    if verb == "run" and f'"{name} =' not in _NODES:
        return f"no node {name}"
    if verb == "launch":
        file = ROOT / "semloc_ros" / "launch" / name
        if not file.exists():
            return f"no launch file {name}"
        text = file.read_text(encoding="utf-8")
        given = [word.split(":=")[0] for word in words[3:] if ":=" in word]
        return next(
            (f"no launch argument {one}" for one in given if not re.search(rf"\b{one}\b", text + _PARAMETERS)), None
        )
    given = [words[at + 1].split(":=")[0] for at, word in enumerate(words[:-1]) if word == "-p"]
    return next((f"no parameter {one}" for one in given if not re.search(rf"^    {one}:", _PARAMETERS, re.M)), None)
