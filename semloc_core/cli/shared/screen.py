"""Where the commands print: results on stdout, words for the person on stderr."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from semloc_core.metrics import Pivot

WIDEST = 10_000

LONGEST_NAME = 60

# Names of buildings, classes and files are a person's words: `[hq]` and `:smile:` are to be printed, not read.
console = Console(markup=False, emoji=False, highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """One line for the person, on stderr, so that stdout stays for results."""
    sys.stderr.write(text + "\n")


def many(count: int, name: str, plural: str | None = None) -> str:
    """``1 place``, ``2 places``; `plural` where an s does not make it."""
    return f"{count} {name if count == 1 else plural or name + 's'}"


def point(at: Sequence[float]) -> str:
    """A position in metres, to the centimetre."""
    return "({:.2f}, {:.2f}, {:.2f})".format(*at)


def cut(name: str) -> str:
    """A name for a table's cell: what is longer than `LONGEST_NAME` characters ends in ``…``."""
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"


def plain_table(header_style: str = "bold") -> Table:
    """A table without a frame, its columns two spaces apart."""
    return Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style=header_style)


def print_whole(table: Table, to: Console) -> None:
    """Print a table as wide as it is: a figure that a narrow screen cuts off is a wrong figure."""
    table.width = to.measure(table, options=to.options.update(width=WIDEST)).maximum
    to.print(table, crop=False)


def print_pivot(pivot: Pivot, to: Console) -> None:
    """Print a small table: a line a method; where a method has no figure the cell is empty."""
    to.print(Text.assemble("\n", (pivot.title, "bold")))
    table = plain_table("dim")
    table.add_column("method")
    for column in pivot.columns:
        table.add_column(column, justify="right")
    for method, figures in pivot.lines.items():
        table.add_row(method, *(f"{figures[c]:.3f}" if c in figures else "" for c in pivot.columns))
    print_whole(table, to)
