"""Labelspaces made of what files bring along: of one file, and of several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import folded, is_nameless, placeholder


def labelspace_from_hydra(name: str, names: Iterable[tuple[int, str]] | None, labels: Iterable[int]) -> Labelspace:
    """The labelspace that a Hydra file brings along.

    Args:
        name: what to call it.
        names: the file's (id, name) pairs, ``metadata.labelspaces._l2p0``; None where it has none.
        labels: the ids that occur in the file; without ``names``, id 7 is called ``class_7``.

    Returns:
        Classes by rising id; a name that stands at several ids, in whatever spelling, has all of them, in that of the
        first. A number of the file whose name is empty is called by its number; `NAMELESS` is no class.

    Raises:
        LabelspaceError: an id with two names.

    """
    found = set(labels)
    if names is None:
        pairs = [(i, placeholder(i)) for i in sorted(found)]
    else:
        given = [(i, spelling if spelling.strip() else placeholder(i)) for i, spelling in set(names)]
        pairs = sorted(pair for pair in given if pair[0] in found or pair[1] != placeholder(pair[0]))
    first: dict[str, str] = {}
    ids: dict[str, tuple[int, ...]] = {}
    for number, spelling in pairs:
        if not is_nameless(spelling):
            class_name = first.setdefault(folded(spelling), spelling)
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
    spelling: dict[str, str] = {}
    same = all(space.classes == spaces[0].classes for space in spaces)
    for class_name in spaces[0].classes if same else sorted({c for space in spaces for c in space.classes}):
        spelling.setdefault(folded(class_name), class_name)
    targets: dict[str, set[str]] = {}
    for space in spaces:
        for other, target in space.synonyms.items():
            targets.setdefault(other, set()).add(target if same else spelling[folded(target)])
    synonyms: dict[str, str] = {}
    for other in sorted(targets):
        if len(targets[other]) > 1 or targets[other] & targets.keys():
            raise LabelspaceError(f"expected a synonym of one class (got {other!r} for {sorted(targets[other])})")
        (synonyms[other],) = targets[other]
    joined = {folded(other): target for other, target in synonyms.items()}

    def own(class_name: str) -> str:
        """The result's name of a class of a space: as spelt there where the spaces are alike."""
        return synonyms.get(class_name) or (
            class_name if same else joined.get(folded(class_name)) or spelling[folded(class_name)]
        )

    classes = dict.fromkeys(own(c) for space in spaces for c in space.classes)
    if not same:
        classes = dict.fromkeys(sorted(classes))
    owners: dict[int, set[str]] = {}
    for space in spaces:
        for class_name, numbers in space.ids.items():
            for number in numbers:
                owners.setdefault(number, set()).add(own(class_name))
    ids: dict[str, tuple[int, ...]] = {}
    for number in sorted(owners):
        if len(owners[number]) == 1:
            (class_name,) = owners[number]
            ids[class_name] = (*ids.get(class_name, ()), number)
    mobility: dict[str, float] = {}
    for space in spaces:
        for class_name, metres in space.mobility.items():
            target = own(class_name)
            mobility[target] = max(metres, mobility.get(target, 0.0))
    return Labelspace(name, tuple(classes), ids, mobility, synonyms, max(space.default_mobility for space in spaces))
