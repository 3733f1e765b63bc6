"""Labels of one file, run or stream turned into classes, by what a `semloc_core.graph.labels.reading.Reading` says."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from semloc_core.graph.labels.cross_walk import REMEMBERED, CrossWalk
from semloc_core.graph.labels.files import shipped_labelspaces
from semloc_core.graph.labels.label_sets import Told, label_sets, likely_sets
from semloc_core.graph.labels.labelspace import Labelspace, listed
from semloc_core.graph.labels.names import folded, is_nameless, number_of, placeholder
from semloc_core.wire import DECIMALS

if TYPE_CHECKING:
    from semloc_core.graph.labels.reading import Reading
    from semloc_core.graph.scene_graph import SceneGraph
    from semloc_core.wire import Object, SceneGraphUpdate

NAMED = 12
"""Labels named at most in a line."""
ALTERNATIVES = 3
"""Classes named at most for one label."""


class Labels:
    """Reads the labels of one file, run or stream, and keeps what it had to decide; see `Reading`."""

    def __init__(self, reading: Reading, names: Mapping[int, str]) -> None:
        self.reading, self._names = reading, names
        said = reading.said
        self._overrules = said is not None and not (reading.shipped and _of_another_numbering(said, names))
        self._guessed: dict[int, str] = {}
        self._overruled: dict[str, str] = {}
        self._kept = False
        self._walked: dict[str, str] = {}
        self._several: dict[str, dict[str, float]] = {}
        self._read_as: dict[str, str] = {}
        self._heard: dict[str, bool] = {}
        self._sets: Told = ()

    def number(self, number: int, own: str | None = None) -> str:
        """The class of an integer label; ``own`` is the name that the file gives it at one object, else as always."""
        own = own or self._names.get(number, "")
        if own.strip() and number_of(own) != number:
            return self._read(own, number, named=True)
        return self._read(placeholder(number), number, named=False)

    def name(self, label: str) -> str:
        """The class of a label that is a name, or a number in place of one."""
        found = self._read_as.get(label)
        if found is None:
            if len(self._read_as) >= REMEMBERED:
                self._read_as.clear()
            found = self._read_as[label] = self._name(label)
        return found

    def _name(self, label: str) -> str:
        number = number_of(label)
        known = self.reading.known
        if number is not None and known is not None and label in known.classes:
            return self._read(label, number, named=True)
        return self._read(label, number, named=number is None)

    def _read(self, label: str, number: int | None, named: bool) -> str:
        reading, space = self.reading, self.reading.space
        joined, said = reading._joined, reading.said
        name = joined.get(folded(label))
        if name is None and number is not None:
            name = joined.get(folded(placeholder(number)))
        if name is None and said is not None and number is not None and (of_number := said.name_of(number)) is not None:
            if not named or self._overrules:
                name = of_number
                if named and folded(said.canonical(label)) != folded(name):
                    self._overruled[f"{number} {label}"] = name if space is None else space.canonical(name)
            elif folded(said.canonical(label)) != folded(of_number):
                self._kept = True
        if name is None:
            name = said.canonical(label) if said is not None else label
        name = joined.get(folded(name), name)
        if space is None:
            return name
        found = space.canonical(name)
        if reading._walk is not None and space.index(name) < 0 and (walked := reading._walk.find(name)) is not None:
            self._walked[name] = found = walked
        if not named and number is not None and name == label and found != label:
            self._guessed[number] = found
        return found

    def graph(self, graph: SceneGraph) -> SceneGraph:
        """A graph with its objects' labels read; the graph itself where none is read otherwise."""
        said = list(graph.objects.values())
        things = self.objects(said)
        return graph if things is said else replace(graph, objects={thing.id: thing for thing in things})

    def update(self, update: SceneGraphUpdate) -> SceneGraphUpdate:
        """An update with its objects' labels read; the update itself where none is read otherwise."""
        things = self.objects(update.objects)
        return update if things is update.objects else msgspec.structs.replace(update, objects=things)

    def objects(self, things: list[Object]) -> list[Object]:
        """Objects with their labels read; the list itself where none is read otherwise."""
        for thing in things:
            self._hear(thing.class_)
            for label in thing.labels or ():
                self._hear(label)
        read = [self._likeliest(thing.class_, thing.labels) for thing in things]
        if all(one == (thing.class_, thing.labels) for one, thing in zip(read, things, strict=True)):
            return things
        return [
            msgspec.structs.replace(thing, class_=name, labels=labels)
            for (name, labels), thing in zip(read, things, strict=True)
        ]

    def _hear(self, label: str) -> None:
        """Learn from a name which label set the detector may have."""
        space = self.reading.space
        if label in self._heard or space is None or not self.reading.often or self.reading._walk is None:
            return
        if len(self._heard) >= REMEMBERED:
            self._heard.clear()
        self._heard[label] = space.index(label) < 0
        names = [folded(each) for each in self._heard]
        foreign = [folded(each) for each, unknown in self._heard.items() if unknown and not is_nameless(each)]
        sets = likely_sets(names, foreign)
        if sets != self._sets:
            self._sets = sets
            self._several.clear()

    def _likeliest(self, class_: str, labels: Mapping[str, float] | None) -> tuple[str, Mapping[str, float] | None]:
        """What an object most likely is, and all it may be: what becomes one class adds up, no name is the rest."""
        own = self.name(class_)
        if labels is None:
            if not (several := self._mixture(class_)):
                return own, None
            return next(iter(several)), several
        shares: dict[str, list[float]] = {}
        for label, p in labels.items():
            if not is_nameless(name := self.name(label)):
                for each, share in (self._mixture(label) or {name: 1.0}).items():
                    shares.setdefault(each, []).append(p * share)
        if not shares:
            return own, None
        found = {name: min(math.fsum(p), 1.0) for name, p in shares.items()}
        # Of equals, as the wire writes them, the object's own class stays; else the first by name.
        best = min(found, key=lambda name: (-round(found[name], DECIMALS), name != own, name))
        return best, found

    def _mixture(self, label: str) -> Mapping[str, float]:
        """What a label may be any of, by how often the map has each, the likeliest first; empty for one class."""
        often, walk = self.reading.often, self.reading._walk
        if not often or walk is None:
            return {}
        if label not in self._several:
            if len(self._several) >= REMEMBERED:
                self._several.clear()
            self._several[label] = self._shares(label, walk, often)
        return self._several[label]

    def _shares(self, label: str, walk: CrossWalk, often: Mapping[str, float]) -> dict[str, float]:
        said, joined = self.reading.said, self.reading._joined
        name = said.canonical(label) if said is not None else label
        if number_of(label) is not None or folded(label) in joined or folded(name) in joined:
            return {}
        shares = walk.shares(name, often, self._sets)
        return shares if shares.keys() - {self.name(label)} else {}

    def told(self) -> list[str]:
        """A line for each thing that had to be decided; none where the labels themselves said all."""
        lines, space, said = [], self.reading.space, self.reading.said
        news = [f"{number} {name}" for number, name in sorted(self._guessed.items()) if number_of(name) is None]
        if news and space is not None:
            lines.append(f"class numbers without names, read as labelspace {space.name} has them: {_few(news)}")
        if self._walked and space is not None:
            pairs = [f"{own} → {name}" for own, name in sorted(self._walked.items())]
            lines.append(f"names of another label set, read as labelspace {space.name} has them: {_few(pairs)}")
        if several := {own: list(classes) for own, classes in sorted(self._several.items()) if classes}:
            pairs = [f"{own} → {_few(classes, ALTERNATIVES, ' or ')}" for own, classes in several.items()]
            lines.append(f"names that may be any of several classes, by how often the map has each: {_few(pairs)}")
        if self._overruled and said is not None:
            pairs = [f"{own} → {name}" for own, name in sorted(self._overruled.items())]
            lines.append(f"--labelspace {said.name} overrules the file's own names: {_few(pairs)}")
        if self._kept and said is not None:
            lines.append(f"the file's own class names are kept, since labelspace {said.name} numbers them otherwise")
        return lines


def all_unknown(classes: Iterable[str], space: Labelspace) -> str | None:
    """Why a graph says nothing to a map, where not one object is of a class that the map knows; else None.

    Args:
        classes: of its objects.
        space: the map's.

    """
    counts: dict[str, int] = {}
    for name in classes:
        if space.index(name) >= 0:
            return None
        counts[name] = counts.get(name, 0) + 1
    if not counts:
        return None
    if all(is_nameless(name) for name in counts):
        return "the classes of all objects are unknown"
    return f"all objects are of classes that the map does not know: {listed(counts)}"


def advice(names: Iterable[str]) -> str:
    """The option that helps with classes that a map or model does not know: every command that reads labels has it."""
    if all(number_of(name) is not None for name in names):
        shipped = ", ".join(shipped_labelspaces())
        return f"--labelspace says which classes these numbers are: one of {shipped}, or a YAML file"
    sets = ", ".join(label_sets())
    return f"--synonyms auto joins names of known label sets ({sets}) to the map's, --synonyms FILE any others"


def _of_another_numbering(said: Labelspace, names: Mapping[int, str]) -> bool:
    """Whether most of the names that a file shares with a labelspace stand at other numbers there."""
    shared = [
        (i, said.canonical(name)) for i, name in names.items() if number_of(name) is None and said.index(name) >= 0
    ]
    return sum(said.name_of(i) != name for i, name in shared) > len(shared) / 2


def _few(words: list[str], most: int = NAMED, joint: str = ", ") -> str:
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return joint.join(words[:most]) + more
