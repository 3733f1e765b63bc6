"""Short representations of what holds arrays and graphs: shapes and counts instead of contents."""

from __future__ import annotations

import dataclasses
import reprlib
from typing import Any, TypeVar

MAX_REPR = 300
"""Characters of a representation at most."""
_MAX_PART = 40

T = TypeVar("T", bound=type)


class _Short(reprlib.Repr):
    """Arrays by type and shape, containers of more than a few items by how many, holders within by their name."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = self.maxother = _MAX_PART

    def repr_instance(self, x: Any, level: int) -> str:
        if hasattr(x, "shape") and hasattr(x, "dtype"):
            return f"{str(x.dtype).rpartition('.')[2]}{list(x.shape)}"
        if _fields(x):
            return holder(x, level - 1)
        if hasattr(x, "__len__"):
            return f"{type(x).__name__} of {len(x)}"
        if type(x).__repr__ is object.__repr__:  # type: ignore[comparison-overlap]
            return f"{type(x).__name__}(…)"
        return super().repr_instance(x, level)

    def _counted(self, x: Any, level: int) -> str:
        name = type(x).__name__
        if len(x) > 4:
            return f"{name} of {len(x)}"
        whole: str = getattr(super(), f"repr_{name}")(x, level)
        return whole if len(whole) <= _MAX_PART else f"{name} of {len(x)}"

    repr_list = repr_tuple = repr_dict = repr_set = repr_frozenset = _counted

    def repr_bytes(self, x: bytes, level: int) -> str:
        return f"bytes of {len(x)}"


def holder(x: Any, level: int = 3) -> str:
    """``Name(field=…, …)`` of a dataclass, a message or a named tuple, at most `MAX_REPR` characters."""
    name = type(x).__qualname__
    if level <= 1:
        called = getattr(x, "name", None)
        return f"{name}({called!r})" if isinstance(called, str) and len(called) <= _MAX_PART else f"{name}(…)"
    fields = _fields(x)
    if not fields and hasattr(x, "__len__"):
        return f"{name} of {len(x)}"
    text = ""
    for field in fields:
        part = f"{', ' if text else ''}{field}={_SHORT.repr1(getattr(x, field, None), level - 1)}"
        if len(name) + len(text) + len(part) + 5 > MAX_REPR:
            text += ", …"
            break
        text += part
    return f"{name}({text})"


def short_repr(cls: T) -> T:
    """Give a class of fields that hold arrays, graphs or long lists a representation that fits on a screen."""
    cls.__repr__ = holder  # type: ignore[method-assign, assignment]
    return cls


def _fields(x: Any) -> tuple[str, ...]:
    if isinstance(x, type):
        return ()
    if dataclasses.is_dataclass(x):
        return tuple(field.name for field in dataclasses.fields(x) if field.repr)
    return tuple(getattr(x, "_fields", ()) or getattr(x, "__struct_fields__", ()))


_SHORT = _Short()
