"""Class names: which are one name, which stand for a number, and which for none."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import lru_cache

from semloc_core.wire import NAMELESS

LARGEST_ID = 2**32 - 1  # Hydra's semantic_label is an unsigned 32-bit integer
LONGEST = 200
"""Longer names are nobody's class: not worth the time."""
_JOINTS = re.compile(r"[\s_\-\u2010-\u2015\u2212]+")
_NUMBER = re.compile(r"(?:class)?([0-9]{1,10})")


def folded(name: str) -> str:
    """What is left of a name without case, spaces, hyphens and underscores: names that agree in it are one name."""
    if len(name) > LONGEST:
        return name
    return unicodedata.normalize("NFKC", _JOINTS.sub("", unicodedata.normalize("NFKC", name).casefold())) or name


def placeholder(number: int) -> str:
    """What a class number without a name is called."""
    return f"class_{number}"


def number_of(name: str) -> int | None:
    """The number that stands in place of a name, as ``class_7`` or ``7``; None for a name."""
    found = _NUMBER.fullmatch(folded(name))
    return int(found[1]) if found is not None and int(found[1]) <= LARGEST_ID else None


@lru_cache(maxsize=4096)
def is_nameless(name: str) -> bool:
    """Whether this is the reserved name of objects whose class is not known."""
    return folded(name) == NAMELESS


def all_numbers(names: Iterable[str]) -> bool:
    """Whether these are numbers for want of names, as `labelspace_from_hydra` calls the classes of such a file."""
    return all(number_of(name) is not None for name in names)
