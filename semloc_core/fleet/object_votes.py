"""Which buildings of a large map the objects around a robot speak for: pairs of them, and how many of each class.

A building that has two objects of some classes as far apart as two that were seen is voted for, the more the fewer
buildings have such a pair; so is one that has as many objects of a class. What was not seen speaks against none.
(An inverted index as of words in documents: Sivic and Zisserman, "Video Google", ICCV 2003. A weight is the logarithm
of how much more often the right building has such a pair, in `FOUND` of all cases, than one of its size has it by
chance.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import MapError
from semloc_core.graph import Floats, Ints, Labelspace, SceneGraph, ranges
from semloc_core.text import short_repr

Key = tuple[str, str]

REACH_M, HIGHER_M = 7.0, 3.0
"""Objects farther apart in the plane, or in height, make no pair."""
BIN_M, BESIDE = 0.25, 2
"""A pair's distance is kept to a bin, and found from as many bins on either side: a detector errs by so much."""
_BINS = round(REACH_M / BIN_M) + BESIDE + 1
MOST_SEEN, MOST_MAPPED = 64, 1024
"""Objects that vote at most, the nearest to the robot; and objects of a building that are voted for, the first."""
FOUND, COUNTED, MOST_COUNTED = 0.5, 0.7, 4
"""Of the pairs seen in a building, and of the classes seen so often, the share that its map has too; and how often a
class is counted at most. Chosen on generated homes, with the next two: 1,000 alike in size, 300 of up to 3 storeys."""
CLASS_WEIGHT = 2.0
SIZED = 0.7
"""Chance goes with this power of how many pairs, or objects, a building has: a large one has more by chance."""
SURELY = 1 - 1e-9
_OBJECT = np.dtype([("class", "<u2"), ("at", "<f4", 3)])


@short_repr
@dataclass(frozen=True, eq=False)
class MappedObjects:
    """A building's objects of known classes.

    Args:
        positions: (k, 3) float32, metres.
        classes: (k,) indices into the map's labelspace.

    """

    positions: NDArray[np.float32]
    classes: Ints

    @classmethod
    def of(cls, positions: Floats, classes: Ints) -> MappedObjects:
        """The first `MOST_MAPPED` of (n, 3) objects, metres, of known classes (n,)."""
        known = np.flatnonzero(classes >= 0)[:MOST_MAPPED]
        return cls(positions[known].astype(np.float32), classes[known].astype(np.int64))

    def pack(self) -> bytes:
        """Fourteen bytes an object."""
        packed = np.zeros(len(self.classes), dtype=_OBJECT)
        packed["class"], packed["at"] = self.classes, self.positions
        return packed.tobytes()

    @classmethod
    def unpack(cls, data: bytes, n_classes: int) -> MappedObjects:
        """What `pack` made.

        Raises:
            MapError: something else, a class that the labelspace of so many does not have.

        """
        if len(data) % _OBJECT.itemsize or len(data) > MOST_MAPPED * _OBJECT.itemsize:
            raise MapError(f"expected a building's objects (got {len(data)} bytes: the map is damaged)")
        packed = np.frombuffer(data, dtype=_OBJECT)
        classes, positions = packed["class"].astype(np.int64), packed["at"].copy()
        if (classes >= n_classes).any() or not np.isfinite(positions).all() or (np.abs(positions) > 1e7).any():
            raise MapError("expected objects of the map's classes at finite positions (got others: the map is damaged)")
        return cls(positions, classes)

    @cached_property
    def keys(self) -> NDArray[np.int64]:
        """(p,) numbers of pairs, rising: of both classes, and of the bins around the distance between them."""
        key = _keys(self.positions.astype(np.float64), self.classes)
        around = key[:, None] + np.arange(-BESIDE, BESIDE + 1)
        # Below the first bin of a kind of pair is another kind's last: none are kept there.
        inside = around // _BINS == (key // _BINS)[:, None]
        found: NDArray[np.int64] = np.unique(around[inside])
        return found


def objects_of(graph: SceneGraph, labelspace: Labelspace) -> MappedObjects:
    """A building's, by rising id."""
    return MappedObjects.of(*_by_id(graph, labelspace))


class ObjectVotes:
    """The objects of many buildings.

    Args:
        buildings: B.
        n_classes: C.

    """

    def __init__(self, buildings: Sequence[MappedObjects], n_classes: int) -> None:
        self._size = len(buildings)
        none = np.zeros(0, dtype=np.int64)
        keys = np.concatenate([none, *(one.keys for one in buildings)])
        of = np.repeat(np.arange(len(buildings), dtype=np.int32), [len(one.keys) for one in buildings])
        order = np.argsort(keys, kind="stable")
        self._buildings = of[order]
        self._keys, first = np.unique(keys[order], return_index=True)
        self._start = np.append(first, len(keys)).astype(np.int64)
        self._log_without = np.log1p(-np.minimum(np.diff(self._start) / max(self._size, 1), SURELY))
        self._sized = _sized([len(one.keys) for one in buildings])
        counts = [np.bincount(one.classes, minlength=n_classes).clip(max=MOST_COUNTED) for one in buildings]
        often = np.array(counts, dtype=np.int64).reshape(-1, n_classes).T
        sized = _sized([len(one.classes) for one in buildings])
        self._worth = np.zeros((MOST_COUNTED + 1, n_classes, self._size), dtype=np.float32)
        for number in range(1, MOST_COUNTED + 1):
            has = often >= number
            share = np.clip(has.sum(axis=1) / max(self._size, 1), 0.5 / max(self._size, 1), SURELY)
            more = CLASS_WEIGHT * _weight(COUNTED, np.log1p(-share)[:, None] * sized)
            self._worth[number] = self._worth[number - 1] + np.where(has, more, 0.0)

    def scores(self, positions: Floats, classes: Ints) -> Floats:
        """(B,) nats that each building is voted for with, by (n, 3) objects, metres, nearest first, of classes (n,)."""
        known = np.flatnonzero(classes >= 0)[:MOST_SEEN]
        positions, classes = positions[known], classes[known]
        found = np.zeros(self._size)
        for class_, number in zip(*np.unique(classes, return_counts=True), strict=True):
            found += self._worth[min(number, MOST_COUNTED), class_]
        if not len(self._keys):
            return found
        seen, often = np.unique(_keys(positions, classes), return_counts=True)
        at = np.minimum(np.searchsorted(self._keys, seen), len(self._keys) - 1)
        hit = self._keys[at] == seen
        at, often = at[hit], often[hit]
        sizes = np.diff(self._start)[at]
        voted = self._buildings[ranges(self._start[at], sizes)]
        votes = np.repeat(often, sizes) * _weight(FOUND, np.repeat(self._log_without[at], sizes) * self._sized[voted])
        found += np.bincount(voted, votes, minlength=self._size)
        return found


def _sized(numbers: Sequence[int]) -> Floats:
    """(B,) how much likelier chance makes a building of so many pairs, or objects, have one of any kind."""
    found: Floats = np.asarray(numbers, dtype=np.float64) / max(float(np.mean(numbers)) if len(numbers) else 0.0, 1.0)
    return found**SIZED


def _weight(found: float, log_without: Floats) -> Floats:
    """What it is worth to be found in a share of the cases and else by chance, given the logarithm of its absence."""
    weight: Floats = np.log1p(found / ((1 - found) * np.maximum(-np.expm1(log_without), 1e-9)))
    return weight


def seen_objects(graph: SceneGraph, labelspace: Labelspace, place: str) -> tuple[Floats, Ints]:
    """(n, 3) the objects that a robot knows, metres, by how far from a place of its graph, and (n,) their classes."""
    return nearest_first(*_by_id(graph, labelspace), graph.places[place])


def _by_id(graph: SceneGraph, labelspace: Labelspace) -> tuple[Floats, Ints]:
    """(n, 3) a graph's objects by rising id, metres, and (n,) their classes."""
    things = [graph.objects[id_] for id_ in sorted(graph.objects)]
    positions = np.array([thing.position for thing in things], dtype=np.float64).reshape(-1, 3)
    return positions, np.array([labelspace.index(thing.class_) for thing in things], dtype=np.int64)


def nearest_first(positions: Floats, classes: Ints, at: Sequence[float] | Floats) -> tuple[Floats, Ints]:
    """Objects (n, 3), metres, and (n,) their classes by how far they are from a point in the plane."""
    away = np.round(np.hypot(positions[:, 0] - at[0], positions[:, 1] - at[1]), 6)
    order = np.argsort(away, kind="stable")
    return positions[order], classes[order]


class KnownObjects:
    """The objects of a map's buildings, kept from one state of the map to the next. Not thread-safe."""

    def __init__(self) -> None:
        self._held: dict[Key, MappedObjects | None] = {}
        self._votes: tuple[tuple[Key, ...], tuple[str, ...], ObjectVotes] | None = None

    def votes(
        self,
        keys: Sequence[Key],
        n_classes: int,
        read: Callable[[Sequence[str]], Mapping[str, MappedObjects] | None],
    ) -> tuple[tuple[str, ...], ObjectVotes] | None:
        """The buildings whose objects are known, and the votes for these; None where the map is not what it was.

        Args:
            keys: of all buildings that can be voted for: the name, and what tells it from others of that name.
            n_classes: of the map.
            read: gives the objects of some buildings, or None where one of them is gone.

        """
        wanted = tuple(keys)
        if self._votes is None or self._votes[0] != wanted:
            missing = [key for key in wanted if key not in self._held]
            found = read([name for name, _ in missing]) if missing else {}
            if found is None:
                return None
            held = {key: self._held[key] if key in self._held else found.get(key[0]) for key in wanted}
            known = [(name, its) for (name, _), its in held.items() if its is not None]
            self._held = held
            self._votes = wanted, tuple(name for name, _ in known), ObjectVotes([its for _, its in known], n_classes)
        return self._votes[1:]


def _keys(positions: Floats, classes: Ints) -> NDArray[np.int64]:
    """(p,) numbers of the pairs of some objects: the classes, the lower one first, and the bin of the distance."""
    i, j = np.triu_indices(len(classes), 1)
    off = positions[j] - positions[i]
    metres = np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2)
    near = (metres < REACH_M) & (np.abs(off[:, 2]) < HIGHER_M)
    a, b = np.sort([classes[i[near]], classes[j[near]]], axis=0)
    # Bins are shifted: round numbers of metres lie amid one, so that no last bit decides.
    bins = np.floor(metres[near] / BIN_M + 0.37).astype(np.int64)
    found: NDArray[np.int64] = ((a << 16) + b) * _BINS + bins
    return found
