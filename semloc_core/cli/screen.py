"""Where the commands print: results on stdout, words for the person on stderr."""

from __future__ import annotations

import sys

from rich.console import Console

console = Console(highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """One line for the person, on stderr, so that stdout stays for results."""
    sys.stderr.write(text + "\n")
