"""How the labels of what is asked of a map are read: names of another label set by what the map has, too."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from weakref import WeakKeyDictionary

from semloc_core.graph import Reading
from semloc_core.map_database.loaded import LoadedMap

_COUNTS: WeakKeyDictionary[LoadedMap, dict[str, int]] = WeakKeyDictionary()


def reading_for(
    loaded: LoadedMap,
    labelspace: str | None = None,
    synonyms: str | Path | None = None,
    topic: str | None = None,
    robot: str | None = None,
) -> Reading:
    """What a person says of a run or graph that is asked of a map; with ``auto`` the map's own counts of its classes.

    Args:
        loaded: the map; of a part of one that a server keeps, the buildings that are held count.
        labelspace: as of `Reading.of`.
        synonyms: the same.
        topic: the same.
        robot: the same.

    Raises:
        LabelspaceError: as `Reading.of`.

    """
    return in_the_words_of(loaded, Reading.of(labelspace, synonyms, topic=topic, robot=robot))


def in_the_words_of(loaded: LoadedMap, said: Reading) -> Reading:
    """The same, asked of a map.

    Raises:
        LabelspaceError: a synonym of a class that the map does not have.

    """
    return said.with_known(loaded.model.labelspace, class_counts(loaded) if said.auto else None)


def class_counts(loaded: LoadedMap) -> dict[str, int]:
    """How many objects of each class the buildings have that a map holds; empty for a map that no file holds."""
    if loaded not in _COUNTS:
        held = loaded.buildings[: len(loaded.stored)]
        _COUNTS[loaded] = dict(Counter(thing.class_ for name in held for thing in loaded.graph(name).objects.values()))
    return _COUNTS[loaded]
