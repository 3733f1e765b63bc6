"""Where the commands print: results on stdout, words for the person on stderr."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

WIDEST = 10_000

console = Console(highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """One line for the person, on stderr, so that stdout stays for results."""
    sys.stderr.write(text + "\n")


def print_whole(table: Table, to: Console) -> None:
    """Print a table as wide as it is: a figure that a narrow screen cuts off is a wrong figure."""
    table.width = to.measure(table, options=to.options.update(width=WIDEST)).maximum
    to.print(table, crop=False)
