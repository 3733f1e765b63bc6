"""Which name of one label set is which of another's, or a kind of it: `label_sets.yaml`, sets and what they share."""

from __future__ import annotations

import re
from collections.abc import Set
from functools import cache

import msgspec

from semloc_core.graph.labels.files import LABEL_SETS, read_yaml, shipped_labelspaces
from semloc_core.graph.labels.labelspace import Labelspace, folded, is_nameless, load_labelspace, number_of

_PARTS = re.compile(r"\s*[,;/|]\s*")


class LabelSet(msgspec.Struct, forbid_unknown_fields=True):
    """One label set: where it is from, under which licence, and its names (none: a shipped labelspace has them).

    ``rest`` are those of its names that stand for whatever it has no other name for.
    """

    source: str
    licence: str
    names: str = ""
    rest: list[str] = []


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


@cache
def _sets() -> tuple[tuple[frozenset[str], frozenset[str]], ...]:
    """Of each label set the groups that it names, and those of its names for whatever it has no other name for."""
    found = []
    for name, names in label_sets().items():
        rest = frozenset(_group(each) for each in _shipped().sets[name].rest)
        found.append((frozenset(_group(each) for each in names) - rest, rest))
    return tuple(found)


def _words(name: str) -> list[str]:
    """The groups of a name and of each of its words for one thing."""
    return list(dict.fromkeys(_group(word) for word in (name, *_PARTS.split(name)) if word))


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
        self._found: dict[str, tuple[str, ...]] = {}

    def find(self, name: str) -> str | None:
        """The class that a name is, which the labelspace does not have as it stands; None where it is of none.

        The same thing by another name; else the nearest class that it is a kind of; else the class that is a kind of
        it, where that is one. Of a name of several words for one thing (``sofa, couch, lounge``), each is tried.
        """
        found = self._looked_up(name)
        return found[0] if len(found) == 1 else None

    def among(self, name: str) -> tuple[str, ...]:
        """The classes that a name may be any of: the one of `find`, or several.

        Those are the kinds of it that are there, or, of a set's name for the rest (``otherprop``), all that the set
        has neither a name nor a wider one for. Either way what a set names otherwise is not meant by its wider name.
        """
        return self._looked_up(name) or next(filter(None, map(self._rest, _words(name))), ())

    def _looked_up(self, name: str) -> tuple[str, ...]:
        if name not in self._found:
            if len(self._found) >= REMEMBERED:
                self._found.clear()
            self._found[name] = self._search(name)
        return self._found[name]

    def _search(self, name: str) -> tuple[str, ...]:
        if is_nameless(name) or number_of(name) is not None:
            return ()
        for way in (self._same, self._wider, self._kinds):
            for word in _words(name):
                if found := way(word):
                    return found
        return ()

    def _same(self, group: str) -> tuple[str, ...]:
        return (self._class_of[group],) if group in self._class_of else ()

    def _wider(self, group: str) -> tuple[str, ...]:
        passed = {group}
        while (group := _wider().get(group, group)) not in passed:
            if group in self._class_of:
                return (self._class_of[group],)
            passed.add(group)
        return ()

    def _kinds(self, group: str) -> tuple[str, ...]:
        kinds, level = set[str](), {group}
        while level:
            level = {kind for kind, wider in _wider().items() if wider in level} - kinds
            kinds |= level
        of = [kinds - named for named, _ in _sets() if group in named]
        return self._classes(set[str]().union(*of) or kinds)

    def _rest(self, group: str) -> tuple[str, ...]:
        of = [named for named, rest in _sets() if group in rest]
        return self._classes(
            {each for each in self._class_of if any(not {each, _wider().get(each)} & named for named in of)}
        )

    def _classes(self, groups: Set[str]) -> tuple[str, ...]:
        meant = {self._class_of[group] for group in groups if group in self._class_of}
        return tuple(name for name in self._space.classes if name in meant)


REMEMBERED = 4096
"""Names whose way is kept at most."""
