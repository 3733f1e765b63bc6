"""Semantic classes: their names, the ids a file gives them, their mobility; and the content hash that binds a map."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.names import LARGEST_ID, LONGEST, folded, is_nameless, number_of
from semloc_core.text import short_repr

if TYPE_CHECKING:
    from semloc_core.graph.scene_graph import SceneGraph

_REMEMBERED = 4096


@short_repr
@dataclass(frozen=True)
class Labelspace:
    """An ordered set of class names.

    Names that differ in case, spaces, hyphens and underscores only are one name (`folded`). Of classes that do so all
    the same, as in a model that was trained on them, each is meant by its own spelling, and the first by any other.

    Args:
        name: what people call it, e.g. ``uhumans2_office``; not part of the hash.
        classes: class names; the position in this tuple is the class index of every tensor.
        ids: class name -> the integer labels that mean it in a Hydra file (one name may have several).
        mobility: class name -> standard deviation in metres of where an instance is found on another day;
            a class that is not named has ``default_mobility``.
        synonyms: another detector's name -> a name in ``classes``; wins over a class of that name, and
            ``class_7`` over the class of id 7.
        default_mobility: metres.

    Raises:
        LabelspaceError: an empty or repeated class name; ids, mobility or a synonym of a class that is not there;
            an id of two classes; a mobility that is negative or not finite; an empty synonym.

    """

    name: str
    classes: tuple[str, ...]
    ids: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    mobility: Mapping[str, float] = field(default_factory=dict)
    synonyms: Mapping[str, str] = field(default_factory=dict)
    default_mobility: float = 0.1

    def __post_init__(self) -> None:
        if problem := _problem(self):
            raise LabelspaceError(f"{problem} in labelspace {self.name!r}")

    @cached_property
    def _index(self) -> dict[str, int]:
        index = {name: i for i, name in enumerate(self.classes)}
        return index | {other: index[name] for other, name in self.synonyms.items()}

    @cached_property
    def _variants(self) -> dict[str, int]:
        """Class index by `folded` name."""
        found: dict[str, int] = {}
        for name in (*self.classes, *self.synonyms):
            found.setdefault(folded(name), self._index[name])
        return found

    @cached_property
    def _remembered(self) -> dict[str, int]:
        """What `index` found for names that are spelt otherwise; so many at most."""
        return {}

    @cached_property
    def _name_of_id(self) -> dict[int, str]:
        named = {number: name for name, numbers in self.ids.items() for number in numbers}
        said = {number_of(other): name for other, name in self.synonyms.items()}
        return named | {number: name for number, name in said.items() if number is not None}

    def __len__(self) -> int:
        return len(self.classes)

    def index(self, name: str) -> int:
        """Class index of a name, a synonym or a number in place of a name; -1 where the labelspace has it not."""
        found = self._index.get(name)
        if found is None and (found := self._remembered.get(name)) is None:
            found = self._variants.get(folded(name), -1)
            if found < 0 and (number := number_of(name)) is not None and (named := self.name_of(number)) is not None:
                found = self._index[named]
            if len(name) <= LONGEST and len(self._remembered) < _REMEMBERED:
                self._remembered[name] = found
        return found

    def canonical(self, name: str) -> str:
        """The labelspace's own name of a class; a name that it does not have as it is."""
        found = self.index(name)
        return self.classes[found] if found >= 0 else name

    def name_of(self, label: int) -> str | None:
        """Class name of an integer label, or None where the labelspace does not have it."""
        return self._name_of_id.get(label)

    def mobility_of(self, name: str) -> float:
        """Displacement's standard deviation of a class, in metres."""
        return self.mobility.get(name, self.default_mobility)

    @cached_property
    def hash(self) -> str:
        """sha256 (hex) of what changes the meaning of an embedding: the class names in order.

        Ids and synonyms are not in it: they say how a file's or a detector's labels become these names, so that a
        robot with another detector can use the map. Nor is mobility: it acts in training only, and the model that
        was trained has a hash of its own.
        """
        return hashlib.sha256(json.dumps(list(self.classes)).encode()).hexdigest()

    def with_synonyms(self, synonyms: Mapping[str, str]) -> Labelspace:
        """The same labelspace, which also knows another detector's names; its hash does not change.

        Args:
            synonyms: the detector's name -> a class of this labelspace. They win over what the name meant before, as
                a synonym, a class, or a number.

        Raises:
            LabelspaceError: a synonym points to no class, or to one that is joined to another.

        """
        said: dict[str, str] = {}
        for other, name in synonyms.items():
            if self.index(name) < 0:
                raise LabelspaceError(f"expected a synonym of a class of {self.name} (got {name!r} for {other!r})")
            said[other] = self.canonical(name)
        meant = {folded(other): name for other, name in said.items()}
        for other, name in said.items():
            if meant.get(folded(name), name) != name:
                raise LabelspaceError(
                    f"expected synonyms of classes that mean themselves (got {other!r} for {name!r}, which is joined "
                    f"to {meant[folded(name)]!r})"
                )
        kept = {other: name for other, name in self.synonyms.items() if folded(other) not in meant}
        spelt = {name: meant[key] for name in self.classes if (key := folded(name)) in meant and name != meant[key]}
        return replace(self, synonyms={**kept, **spelt, **said})

    def with_ids_of(self, other: Labelspace) -> Labelspace:
        """The same classes, for files whose integer labels mean what another labelspace says; same hash.

        An id of a class that this labelspace lacks means nothing here, whatever it meant before.
        """
        ids: dict[str, tuple[int, ...]] = {}
        for name, numbers in other.ids.items():
            if (index := self.index(name)) >= 0:
                ids[self.classes[index]] = (*ids.get(self.classes[index], ()), *numbers)
        return replace(self, ids=ids)


def _problem(space: Labelspace) -> str | None:
    for name, times in Counter(space.classes).items():
        if times > 1 or not name:
            return f"expected each class once, with a name (got {name!r} {times} times)"
    known = set(space.classes)
    for what, names in (
        ("ids", space.ids),
        ("mobility", space.mobility),
        ("a synonym", space.synonyms.values()),
    ):
        for name in names:
            if name not in known:
                return f"expected {what} of a class (got {name!r}, which is none)"
    owner: dict[int, str] = {}
    for name, numbers in space.ids.items():
        for number in numbers:
            if not 0 <= number <= LARGEST_ID:
                return f"expected ids of 32 bits (got {number} of {name!r})"
            if number in owner:
                return f"expected each id once (got {number} of {owner[number]!r} and {name!r})"
            owner[number] = name
    for name, metres in [*space.mobility.items(), ("any class", space.default_mobility)]:
        if not (math.isfinite(metres) and metres >= 0):
            return f"expected a mobility of at least 0 m (got {metres} for {name!r})"
    if "" in space.synonyms:
        return "expected synonyms with a name (got '')"
    return None


def count_unknown(graph: SceneGraph, labelspace: Labelspace) -> dict[str, int]:
    """How many objects of each class the labelspace does not have, most frequent first.

    Such objects stay in the graph but say nothing to an encoder: whoever embeds a graph reports these. Those that
    have no name (`NAMELESS`) are of no class.
    """
    counts = Counter(thing.class_ for thing in graph.objects.values() if lacks(labelspace, thing.class_))
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def lacks(labelspace: Labelspace, name: str) -> bool:
    """Whether this is a class, and one that the labelspace does not have."""
    return labelspace.index(name) < 0 and not is_nameless(name)


def listed(counts: Mapping[str, int], most: int = 8) -> str:
    """``chair (4), couch (2)`` of objects by class, the most frequent first; beyond ``most`` classes how many more."""
    rows = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{name} ({count})" for name, count in rows[:most])
    return named + (f" and {len(rows) - most} classes more" if len(rows) > most else "")
