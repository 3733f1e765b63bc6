"""Semantic classes: their names, the ids a file gives them, their mobility; and the content hash that binds a map."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labelspace_files import read_labelspace_file, read_synonyms_file, shipped_path
from semloc_core.graph.labelspace_files import shipped_labelspaces as shipped_labelspaces

if TYPE_CHECKING:
    from pathlib import Path

    from semloc_core.graph.scene_graph import SceneGraph

LARGEST_ID = 2**32 - 1  # Hydra's semantic_label is an unsigned 32-bit integer


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
        default_mobility: metres.

    Raises:
        LabelspaceError: an empty or repeated class name; ids, mobility or a synonym of a class that is not there;
            an id of two classes; a mobility that is negative or not finite; a synonym that is itself a class.

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
    def _name_of_id(self) -> dict[int, str]:
        return {number: name for name, numbers in self.ids.items() for number in numbers}

    def __len__(self) -> int:
        return len(self.classes)

    def index(self, name: str) -> int:
        """Class index of a name or synonym, or -1 where the labelspace does not have it."""
        return self._index.get(name, -1)

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
            synonyms: the detector's name -> a class of this labelspace.

        Raises:
            LabelspaceError: a synonym points to no class, is a class, or already means another one.

        """
        for other, name in synonyms.items():
            known = self.synonyms.get(other, name)
            if known != name:
                raise LabelspaceError(f"expected {other!r} to mean {known!r} still (got {name!r})")
        return replace(self, synonyms={**self.synonyms, **synonyms})

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
    for other in space.synonyms:
        if other in known or not other:
            return f"expected synonyms that are not classes themselves (got {other!r})"
    return None


def load_labelspace(name_or_path: str | Path) -> Labelspace:
    """A labelspace that semloc ships, by name, or one from a YAML file.

    Args:
        name_or_path: one of `shipped_labelspaces`, or the path of a file like these.

    Raises:
        LabelspaceError: neither, or the file is not right; names the file.

    """
    path = shipped_path(str(name_or_path))
    content = read_labelspace_file(path)
    try:
        return Labelspace(
            name=content.name,
            classes=tuple(row.name for row in content.classes),
            ids={row.name: tuple(row.ids) for row in content.classes if row.ids},
            mobility={row.name: row.mobility for row in content.classes if row.mobility is not None},
            synonyms=content.synonyms,
            default_mobility=content.default_mobility,
        )
    except LabelspaceError as error:
        raise LabelspaceError(f"{error} ({path})") from None


def load_synonyms(path: str | Path) -> dict[str, str]:
    """A synonym file (YAML, ``synonyms: {a detector's name: a map's class}``) for `Labelspace.with_synonyms`.

    Raises:
        LabelspaceError: the file can't be read or is not right.

    """
    return read_synonyms_file(path)


def labelspace_from_hydra(name: str, names: Iterable[tuple[int, str]] | None, labels: Iterable[int]) -> Labelspace:
    """The labelspace that a Hydra file brings along.

    Args:
        name: what to call it.
        names: the file's (id, name) pairs, ``metadata.labelspaces._l2p0``; None where it has none.
        labels: the ids that occur in the file; without ``names``, id 7 is called ``class_7``.

    Returns:
        Classes by rising id; a name that stands at several ids has all of them.

    Raises:
        LabelspaceError: an id with two names, or an empty name.

    """
    pairs = sorted(set(names)) if names is not None else [(i, f"class_{i}") for i in sorted(set(labels))]
    ids: dict[str, tuple[int, ...]] = {}
    for number, class_name in pairs:
        ids[class_name] = (*ids.get(class_name, ()), number)
    return Labelspace(name=name, classes=tuple(ids), ids=ids)


def union(spaces: Sequence[Labelspace], name: str = "union") -> Labelspace:
    """One labelspace that has the classes of several, whatever order they come in.

    A class that is another's synonym is joined to it. Labelspaces with the same classes keep their order; else
    the classes are sorted by name. An id that means different classes is left out: files that use it name their
    classes themselves. Of two mobilities the larger is taken.

    Args:
        spaces: at least one.
        name: of the result.

    Raises:
        LabelspaceError: no labelspace, or a synonym that means two classes.

    """
    if not spaces:
        raise LabelspaceError("expected at least one labelspace (got none)")
    targets: dict[str, set[str]] = {}
    for space in spaces:
        for other, target in space.synonyms.items():
            targets.setdefault(other, set()).add(target)
    synonyms: dict[str, str] = {}
    for other in sorted(targets):
        if len(targets[other]) > 1 or targets[other] & targets.keys():
            raise LabelspaceError(f"expected a synonym of one class (got {other!r} for {sorted(targets[other])})")
        (synonyms[other],) = targets[other]

    classes = dict.fromkeys(synonyms.get(c, c) for space in spaces for c in space.classes)
    if any(space.classes != spaces[0].classes for space in spaces):
        classes = dict.fromkeys(sorted(classes))
    owners: dict[int, set[str]] = {}
    for space in spaces:
        for class_name, numbers in space.ids.items():
            for number in numbers:
                owners.setdefault(number, set()).add(synonyms.get(class_name, class_name))
    ids: dict[str, tuple[int, ...]] = {}
    for number in sorted(owners):
        if len(owners[number]) == 1:
            (class_name,) = owners[number]
            ids[class_name] = (*ids.get(class_name, ()), number)
    mobility: dict[str, float] = {}
    for space in spaces:
        for class_name, metres in space.mobility.items():
            target = synonyms.get(class_name, class_name)
            mobility[target] = max(metres, mobility.get(target, 0.0))
    return Labelspace(name, tuple(classes), ids, mobility, synonyms, max(space.default_mobility for space in spaces))


def count_unknown(graph: SceneGraph, labelspace: Labelspace) -> dict[str, int]:
    """How many objects of each class the labelspace does not have, most frequent first.

    Such objects stay in the graph but say nothing to an encoder: whoever embeds a graph reports these.
    """
    counts = Counter(thing.class_ for thing in graph.objects.values() if labelspace.index(thing.class_) < 0)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def all_numbers(names: Iterable[str]) -> bool:
    """Whether these are numbers for want of names, as `labelspace_from_hydra` calls the classes of such a file."""
    return all(name.removeprefix("class_").isdecimal() and name.startswith("class_") for name in names)


def listed(counts: Mapping[str, int], most: int = 8) -> str:
    """``chair (4), couch (2)`` of objects by class, the most frequent first; beyond ``most`` classes how many more."""
    rows = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{name} ({count})" for name, count in rows[:most])
    return named + (f" and {len(rows) - most} classes more" if len(rows) > most else "")
