"""A package that a command needs and that is not installed: said in a line, with what installs it."""

from __future__ import annotations


def absent(error: ModuleNotFoundError) -> str:
    """The line for a package that is not there.

    Raises:
        ModuleNotFoundError: it is a module of semloc's own that is missing, which no package mends.

    """
    package = (error.name or "").partition(".")[0]
    if package in ("", "semloc_core"):
        raise error
    return f"expected the package {package!r} (got none: pip install 'semloc[tools]' has all that commands need)"
