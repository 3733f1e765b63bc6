"""Which name of one label set is which of another's, or a kind of it: `label_sets.yaml`, sets and what they share."""

from __future__ import annotations

import re
from functools import cache

import msgspec

from semloc_core.graph.labels.files import LABEL_SETS, read_yaml, shipped_labelspaces
from semloc_core.graph.labels.labelspace import Labelspace, folded, is_nameless, load_labelspace, number_of

_PARTS = re.compile(r"\s*[,;/|]\s*")


class LabelSet(msgspec.Struct, forbid_unknown_fields=True):
    """One label set: where it is from, under which licence, and its names (none: a shipped labelspace has them)."""

    source: str
    licence: str
    names: str = ""


class LabelSets(msgspec.Struct, forbid_unknown_fields=True):
    """The file: sets by name; groups of names of one thing; a name -> what it is a kind of."""

    sets: dict[str, LabelSet]
    same: list[list[str]]
    kind_of: dict[str, str]


@cache
def _shipped() -> LabelSets:
    return read_yaml(LABEL_SETS, LabelSets)


def label_sets() -> dict[str, tuple[str, ...]]:
    """The names of every label set that the cross-walk knows, by the set's."""
    return {
        name: load_labelspace(name).classes if name in shipped_labelspaces() else tuple(one.names.split(", "))
        for name, one in _shipped().sets.items()
    }


@cache
def _groups() -> dict[str, str]:
    """Folded name -> the folded first name of its group."""
    return {folded(name): folded(group[0]) for group in _shipped().same for name in group}


@cache
def _wider() -> dict[str, str]:
    """Group -> the group that it is a kind of."""
    return {_group(kind): _group(wider) for kind, wider in _shipped().kind_of.items()}


def _group(name: str) -> str:
    return _groups().get(folded(name), folded(name))


class CrossWalk:
    """From the names of any label set to the classes of one labelspace.

    Args:
        space: where the way leads.

    """

    def __init__(self, space: Labelspace) -> None:
        self._space = space
        self._class_of: dict[str, str] = {}
        for name in (*space.classes, *space.synonyms):
            self._class_of.setdefault(_group(name), space.canonical(name))
        self._found: dict[str, str | None] = {}

    def find(self, name: str) -> str | None:
        """The class that a name is, which the labelspace does not have as it stands; None where it is of none.

        The same thing by another name; else the nearest class that it is a kind of; else the class that is a kind of
        it, where that is one. Of a name of several words for one thing (``sofa, couch, lounge``), each is tried.
        """
        if name not in self._found:
            if len(self._found) >= REMEMBERED:
                self._found.clear()
            self._found[name] = self._search(name)
        return self._found[name]

    def _search(self, name: str) -> str | None:
        if is_nameless(name) or number_of(name) is not None:
            return None
        words = list(dict.fromkeys(_group(word) for word in (name, *_PARTS.split(name)) if word))
        for way in (self._same, self._wider, self._kind):
            for word in words:
                if (found := way(word)) is not None:
                    return found
        return None

    def _same(self, group: str) -> str | None:
        return self._class_of.get(group)

    def _wider(self, group: str) -> str | None:
        passed = {group}
        while (group := _wider().get(group, group)) not in passed:
            if group in self._class_of:
                return self._class_of[group]
            passed.add(group)
        return None

    def _kind(self, group: str) -> str | None:
        level = {group}
        for _ in range(len(_wider())):
            level = {kind for kind, wider in _wider().items() if wider in level}
            here = {self._class_of[kind] for kind in level if kind in self._class_of}
            if here or not level:
                return here.pop() if len(here) == 1 else None
        return None


REMEMBERED = 4096
"""Names whose way is kept at most."""
