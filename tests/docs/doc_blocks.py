"""Commands in the README and the docs: the blocks of them, what is said of each block, and the lines in them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = {"first_runs.md", "licences.md", "ros_transcript.md"}
"""Pages that a program writes: `tools/licences.py`, and `tools/ros_transcript.sh`, which runs
what it shows, as `tools/first_runs.py` does."""
MARK = re.compile(r"<!-- (not run|slow)(?:: (.+))? -->")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PROMPT = re.compile(r"^(?:\$ |semloc |make |ros2 |python )", re.MULTILINE)


class Block(NamedTuple):
    """A fenced block of commands.

    Attributes:
        page: the file.
        line: where it begins, from 1.
        mark: ``None``, ``slow`` or ``not run``, as a comment in the line before it says.
        words: why it is not run, or the options that a slow one's `semloc` is given besides.
        lines: its commands, continued lines joined.

    """

    page: Path
    line: int
    mark: str | None
    words: str
    lines: tuple[str, ...]

    def __repr__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def pages() -> list[Path]:
    """Every page that a person writes."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if page.name not in WRITTEN]


def fences(page: Path) -> list[tuple[int, str, str, str]]:
    """The fenced blocks of a page: line, language, text, the line before."""
    text = page.read_text(encoding="utf-8")
    found = []
    for fence in FENCE.finditer(text):
        above = text[: fence.start()].rstrip("\n").rpartition("\n")[2]
        found.append((text.count("\n", 0, fence.start()) + 1, fence[1], fence[2], above))
    return found


def blocks(page: Path) -> list[Block]:
    """The blocks of commands on a page: ``sh``, and of ``console`` what stands behind a prompt."""
    found = []
    for line, language, text, above in fences(page):
        if language not in ("sh", "console"):
            continue
        text = text.replace("\\\n", " ")
        lines = [one for one in text.splitlines() if one.strip() and not one.lstrip().startswith("#")]
        if language == "console":
            lines = [one.removeprefix("$ ") for one in lines if one.startswith("$ ")]
        mark = MARK.search(above)
        found.append(Block(page, line, mark and mark[1], (mark and mark[2]) or "", tuple(lines)))
    return found


def all_blocks() -> list[Block]:
    """Those of all pages."""
    return [block for page in pages() for block in blocks(page)]


def inline(page: Path) -> list[str]:
    """Commands in running text, between single backquotes."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    found = re.findall(r"(?<!`)`((?:semloc|make|pytest|ros2|python|sh|bash) [^`]+)`", text)
    return [" ".join(one.split()) for one in found]
