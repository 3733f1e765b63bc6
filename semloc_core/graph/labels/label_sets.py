"""Label sets that detectors are trained with, and what their names have in common: `label_sets.yaml`."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import NamedTuple

import msgspec

from semloc_core.graph.labels.files import LABEL_SETS, load_labelspace, read_yaml, shipped_labelspaces
from semloc_core.graph.labels.names import folded
from semloc_core.text import short_repr

LEAST_HEARD = 2
"""From so many names on that the map has not, the detector's label set is told by them."""
THING = "thing"
"""The sort of what is in none of `label_sets.yaml`'s."""


class LabelSet(msgspec.Struct, forbid_unknown_fields=True):
    """One label set: where it is from, under which licence, and its names (none: a shipped labelspace has them).

    ``rest`` are those of its names that stand for whatever it has no other name for, with the sort of thing.
    """

    source: str
    licence: str
    names: str = ""
    rest: dict[str, str] = {}


class LabelSets(msgspec.Struct, forbid_unknown_fields=True):
    """The file: sets by name; sorts of things; groups of names of one thing; a name -> what it is a kind of."""

    sets: dict[str, LabelSet]
    sorts: dict[str, list[str]]
    same: list[list[str]]
    kind_of: dict[str, str]


@short_repr
class Naming(NamedTuple):
    """What a label set calls things, as groups of names (`group`).

    Args:
        spelt: its names, folded.
        named: those of them that stand for one thing.
        rest: those for whatever it has no other name for, with the sort of thing.

    """

    spelt: frozenset[str]
    named: frozenset[str]
    rest: dict[str, str]


Told = tuple[tuple[float, Naming], ...]
"""Label sets that a detector may have, and how likely they are, the likeliest 1."""


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
    return {folded(name): folded(names[0]) for names in _shipped().same for name in names}


def group(name: str) -> str:
    """What all names of one thing have in common."""
    return _groups().get(folded(name), folded(name))


@cache
def wider() -> dict[str, str]:
    """Group -> the group that it is a kind of."""
    return {group(kind): group(name) for kind, name in _shipped().kind_of.items()}


def chain(of: str) -> list[str]:
    """A group, what it is a kind of, and so on."""
    found = [of]
    while (next_ := wider().get(found[-1])) is not None and next_ not in found:
        found.append(next_)
    return found


@cache
def sorts(of: str) -> frozenset[str]:
    """The sorts of thing that a group may be said to be."""
    way = set(chain(of))
    found = {sort for sort, names in _shipped().sorts.items() if way & {group(name) for name in names}}
    return frozenset(found or {THING})


@cache
def namings() -> tuple[Naming, ...]:
    """Of every label set."""
    found = []
    for name, names in label_sets().items():
        rest = {group(each): sort for each, sort in _shipped().sets[name].rest.items()}
        spelt = frozenset(folded(each) for each in names)
        found.append(Naming(spelt, frozenset(group(each) for each in names) - rest.keys(), rest))
    return tuple(found)


def likely_sets(heard: Collection[str], foreign: Collection[str]) -> Told:
    """The label sets that a detector may have by what it says; none where that tells nothing.

    Of sets that have all of it, one of half as many names would have said each twice as often.

    Args:
        heard: names that it said, folded.
        foreign: those of them that the map has not: what the map has too says little.

    """
    scores = [(len(one.spelt & set(foreign)), len(one.spelt & set(heard))) for one in namings()]
    best = max(scores)
    if best[0] < LEAST_HEARD or 2 * best[0] < len(foreign):
        return ()
    found = [one for one, score in zip(namings(), scores, strict=True) if score == best]
    fewest = min(len(one.spelt) for one in found)
    return tuple(((fewest / len(one.spelt)) ** best[1], one) for one in found)
