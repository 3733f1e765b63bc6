"""Semantic classes: their names, the ids a file gives them, their mobility; and the content hash that binds a map."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property


@dataclass(frozen=True)
class Labelspace:
    """An ordered set of class names.

    Args:
        name: what people call it, e.g. ``uhumans2_office``; not part of the hash.
        classes: class names; the position in this tuple is the class index of every tensor.
        ids: class name -> the integer labels that mean it in a Hydra file (one name may have several).
        mobility: class name -> standard deviation in metres of where an instance is found on another day;
            a class that is not named has ``default_mobility``.
        synonyms: another detector's name -> a name in ``classes``.

    """

    name: str
    classes: tuple[str, ...]
    ids: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    mobility: Mapping[str, float] = field(default_factory=dict)
    synonyms: Mapping[str, str] = field(default_factory=dict)
    default_mobility: float = 0.1

    @cached_property
    def _index(self) -> dict[str, int]:
        index = {name: i for i, name in enumerate(self.classes)}
        return index | {other: index[name] for other, name in self.synonyms.items() if other not in index}

    def __len__(self) -> int:
        return len(self.classes)

    def index(self, name: str) -> int:
        """Class index of a name or synonym, or -1 where the labelspace does not have it."""
        return self._index.get(name, -1)

    def mobility_of(self, name: str) -> float:
        """Displacement's standard deviation of a class, in metres."""
        return self.mobility.get(name, self.default_mobility)

    @cached_property
    def hash(self) -> str:
        """sha256 (hex) of what changes the meaning of an embedding: the class names in order."""
        return hashlib.sha256(json.dumps(list(self.classes)).encode()).hexdigest()
