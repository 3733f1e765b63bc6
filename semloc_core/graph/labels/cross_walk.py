"""Which name of one label set is which of another's, or a kind of it, and what a name may be that could be several."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence, Set

from semloc_core.graph.labels.label_sets import Naming, Told, chain, group, namings, sorts, wider
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import is_nameless, number_of

REMEMBERED = 4096
"""Names whose way is kept at most."""
STRAY = 0.03
"""How much a class counts that is of another sort than a name for the rest, or that has a name of its own where none
was given: sets, and those who use them, sort things differently."""
FEW = 1e-3
"""A class with a smaller share of what a name may be is left out."""
_PARTS = re.compile(r"\s*[,;/|]\s*")


class CrossWalk:
    """From the names of any label set to the classes of one labelspace.

    Args:
        space: where the way leads.

    """

    def __init__(self, space: Labelspace) -> None:
        self._space = space
        self._class_of: dict[str, str] = {}
        for name in (*space.classes, *space.synonyms):
            self._class_of.setdefault(group(name), space.canonical(name))
        self._found: dict[str, tuple[str, ...]] = {}

    def find(self, name: str) -> str | None:
        """The class that a name is, which the labelspace does not have as it stands; None where it is of none.

        The same thing by another name; else the nearest class that it is a kind of; else the class that is a kind of
        it, where that is one. Of a name of several words for one thing (``sofa, couch, lounge``), each is tried.
        """
        found = self._looked_up(name)
        return found[0] if len(found) == 1 else None

    def shares(self, name: str, often: Mapping[str, float], sets: Told = ()) -> dict[str, float]:
        """What a name may be any of, by how often the map has each class, the likeliest first; sums to 1.

        That is the class of `find`, or the kinds of it that are there; or, of a set's name for the rest
        (``otherprop``), all that the set has neither a name nor a wider one for, of that sort rather than of another.
        Either way what a set names otherwise is not meant by its wider name. Where the set is known, a class that it
        has names for goes by the wider name too, and what has no name at all is rather what it has none for.

        Args:
            name: what was said.
            often: objects of each class in the map.
            sets: what the detector's label set may be (`likely_sets`); none: any.

        """
        total: dict[str, float] = {}
        for likely, weights in self._weights(name, sets):
            counts = {of: often[of] * weight for of, weight in weights.items() if often.get(of, 0) > 0}
            whole = math.fsum(counts.values())
            for of, count in counts.items():
                total[of] = total.get(of, 0.0) + likely * count / whole
        whole = math.fsum(total.values())
        total = {of: share / whole for of, share in total.items()}
        kept = {of: share for of, share in total.items() if share >= FEW * max(total.values())}
        whole = math.fsum(kept.values())
        return {of: kept[of] / whole for of in sorted(kept, key=lambda of: (-kept[of], of))}

    def _weights(self, name: str, sets: Told) -> list[tuple[float, dict[str, float]]]:
        """How much each class counts, by each of the sets, and how likely that is."""
        if is_nameless(name):
            return [(likely, self._nameless(one)) for likely, one in sets]
        words = _words(name)
        for word in words:
            if any(word in one.rest for one in namings()):
                said = [each for each in sets if word in each[1].rest] or [(1.0, one) for one in namings()]
                return [(likely, self._rest(one, one.rest[word])) for likely, one in said if word in one.rest]
        own = self._space.canonical(name) if self._space.index(name) >= 0 else None
        found = (own,) if own is not None else self._looked_up(name)
        if len(found) == 1:
            kinds = [(likely, self._kinds_of(words, [one])) for likely, one in sets] or [(1.0, ())]
            return [(likely, dict.fromkeys((*found, *its), 1.0)) for likely, its in kinds]
        named = [(likely, self._kinds_of(words, [one])) for likely, one in sets if set(words) & one.named]
        return [(likely, dict.fromkeys(its, 1.0)) for likely, its in named if its] or [(1.0, dict.fromkeys(found, 1.0))]

    def _nameless(self, one: Naming) -> dict[str, float]:
        """What has no name is what the set has none for; what it has one for may have been missed."""
        told = set(one.rest.values())
        return {
            self._class_of[each]: STRAY if _named(each, one) or sorts(each) & told else 1.0 for each in self._class_of
        }

    def _rest(self, one: Naming, sort: str) -> dict[str, float]:
        there = [each for each in self._class_of if not _named(each, one)]
        return {self._class_of[each]: 1.0 if sort in sorts(each) else STRAY for each in there}

    def _kinds_of(self, words: Sequence[str], sets: Sequence[Naming]) -> tuple[str, ...]:
        """Classes that are kinds of one of some words and that no set has a name of its own for, or not all of them."""
        kinds = {each for word in words for each in _kinds(word)}
        meant = set[str]().union(*(kinds - one.named for one in sets)) if sets else kinds
        return self._classes(meant)

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

    def _same(self, of: str) -> tuple[str, ...]:
        return (self._class_of[of],) if of in self._class_of else ()

    def _wider(self, of: str) -> tuple[str, ...]:
        return next(((self._class_of[each],) for each in chain(of)[1:] if each in self._class_of), ())

    def _kinds(self, of: str) -> tuple[str, ...]:
        return self._kinds_of([of], [one for one in namings() if of in one.named])

    def _classes(self, groups: Set[str]) -> tuple[str, ...]:
        meant = {self._class_of[each] for each in groups if each in self._class_of}
        return tuple(name for name in self._space.classes if name in meant)


def _words(name: str) -> list[str]:
    """The groups of a name and of each of its words for one thing."""
    return list(dict.fromkeys(group(word) for word in (name, *_PARTS.split(name)) if word))


def _kinds(of: str) -> set[str]:
    """All groups that are kinds of one, of its kinds, and so on."""
    kinds, level = set[str](), {of}
    while level:
        level = {kind for kind, name in wider().items() if name in level} - kinds
        kinds |= level
    return kinds


def _named(of: str, one: Naming) -> bool:
    """Whether a set has a name for a group, or for what it is a kind of."""
    return bool({of, wider().get(of)} & one.named)
