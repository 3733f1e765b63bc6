"""The command ``semloc``; its words are in `semloc_core.cli.commands`, which is imported once it can be stopped."""

from __future__ import annotations

import sys
from typing import Any

from semloc_core.cli.shared.absent import absent
from semloc_core.cli.shared.ending import print_plainly, stops

__all__ = ["main"]


def main() -> None:
    """Run the command line and exit; whatever a person can get wrong becomes one line on stderr and exit status 2."""
    with stops():
        print_plainly()
        try:
            from semloc_core.cli.commands import run
        except ModuleNotFoundError as error:
            sys.stderr.write(f"semloc: {absent(error)}\n")
            sys.exit(2)
        status = run(sys.argv[1:])
    sys.exit(status)


def __getattr__(name: str) -> Any:
    if name == "app":
        from semloc_core.cli.commands import app

        return app
    raise AttributeError(name)
