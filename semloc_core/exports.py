"""What a room lets others use: the names that its `__init__` lists, each imported when it is first asked for."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any


@cache
def homes(package: str) -> dict[str, tuple[str, str]]:
    """The names that a package hands on -> the module that each comes from, and its name there.

    They are those that its source imports under ``if TYPE_CHECKING:``, where type checkers and people look for them.
    """
    tree = ast.parse(inspect.getsource(sys.modules[package]))
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: (str(node.module), alias.name) for node in imports for alias in node.names}


def exports(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package that imports nothing until it is asked for (PEP 562).

    Args:
        package: its name.

    """

    def __getattr__(name: str) -> Any:
        if name.startswith("__") or name not in homes(package):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, there = homes(package)[name]
        return getattr(import_module(module), there)

    return __getattr__
