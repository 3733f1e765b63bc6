"""Which names a Hydra file gives its objects' labels: its labelspaces, tidied, and whose is whose."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from semloc_core.graph import LARGEST_ID, Labelspace, labelspace_from_hydra
from semloc_core.sources.hydra.format import OBJECT_LABELSPACE, Document, Node


class LabelNames:
    """The names of a file's object labels.

    An object's names are those of its own layer and partition (``_l2p0``); without these, those of another partition
    of the objects' layer, or else the only ones that the file has.

    Args:
        document: the file.
        objects: its object nodes.
        said: takes lines on what was decided or passed over.

    """

    def __init__(self, document: Document, objects: Iterable[Node], said: list[str]) -> None:
        labels = {(_key(node), node.attributes.semantic_label or 0) for node in objects}
        given = document.labelspaces()
        self._spaces = {key: _tidied(key, rows, {n for _, n in labels}, said) for key, rows in given.items()}
        keys = sorted({key for key, _ in labels}) or [OBJECT_LABELSPACE]
        self._space_of = {key: self._chosen(key) for key in keys}
        for key, taken in self._space_of.items():
            if taken not in (None, key):
                said.append(f"the objects have no names of their own ({key}): those of labelspace {taken} are taken")

    def _chosen(self, key: str) -> str | None:
        layer = [OBJECT_LABELSPACE, *sorted(other for other in self._spaces if other.startswith("_l2p"))]
        found = next((k for k in (key, *layer) if self._spaces.get(k)), None)
        if found is None and self._spaces:
            first = next(iter(self._spaces))
            alike = all(names == self._spaces[first] for names in self._spaces.values())
            found = first if alike and self._spaces[first] else None
        return found

    def name_of(self, node: Node) -> str | None:
        """The file's name of an object's label; None where it has none."""
        space, label = self._space_of.get(_key(node)), node.attributes.semantic_label
        return self._spaces[space].get(label) if space is not None and label is not None else None

    @property
    def _used(self) -> list[dict[int, str]]:
        return [self._spaces[space] for space in dict.fromkeys(self._space_of.values()) if space is not None]

    @property
    def of_labels(self) -> dict[int, str]:
        """Label -> name, of all partitions; where two differ, the first's."""
        ids: dict[int, str] = {}
        for names in self._used:
            ids = names | ids
        return ids

    def labelspace(self, name: str, labels: Iterable[int]) -> Labelspace:
        """The file's own labelspace: its names, else ``class_<id>`` of the ids that occur.

        Raises:
            LabelspaceError: a label that is none.

        """
        used = self._used
        if not used:
            return labelspace_from_hydra(name, None, labels)
        own = labelspace_from_hydra(name, self.of_labels.items(), labels)
        others = dict.fromkeys(word for names in used for word in names.values() if word not in own.classes)
        return replace(own, classes=(*own.classes, *others))


def _key(node: Node) -> str:
    layer = node.layer if isinstance(node.layer, int) else 2
    partition = node.partition if isinstance(node.partition, int) else 0
    return f"_l{layer}p{partition}"


def _tidied(key: str, rows: list[tuple[int, str | None]], used: set[int], said: list[str]) -> dict[int, str]:
    """Label -> name, the first where it has several; without empty names and labels that can't be."""
    names: dict[int, str] = {}
    passed: Counter[str] = Counter()
    for label, word in rows:
        if not word or not word.strip():
            passed["without a name" + (", of objects there are" if label in used else "")] += 1
        elif not 0 <= label <= LARGEST_ID:
            passed["that is no 32-bit number"] += 1
        elif names.setdefault(label, word) != word:
            said.append(f"label {label} has two names in {key}: {names[label]!r} is taken, {word!r} passed over")
    said.extend(f"{count} label(s) {why} in {key} passed over" for why, count in passed.items())
    return names
