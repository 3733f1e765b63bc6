"""Places proposed by pairs of objects: every mapped pair that is like a seen one says where the robot would be.

Two objects of certain classes, so far apart, fix a pose. The map's pairs are sorted by their classes and distance, so
that those like a seen pair are one run of them; each hit votes for a cell of building, position and heading, the more
the rarer its like is (a generalised Hough transform). Costs go with the hits, of which the rarest pairs' are taken
first, and not with the places of the map; what has not been seen yet speaks against nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints, ranges
from semloc_core.matching.layout.building.near_pairs import Nearby, nearest
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.compiled.tables import Alike, PairTable
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.text import short_repr

LEAST_M, REACH_M = 0.8, 7.0
"""Pairs are so far apart: nearer ones have no heading, farther ones are too many."""
TOLERANCE_M, HEIGHT_M = 0.7, 0.8
"""Pairs that differ by more in distance, or in difference of height, are not alike."""
VOTERS = 20
"""Seen objects whose pairs vote, the nearest to the robot."""
HITS = 24_000
"""Hits that vote at most, but for those of the rarest pair."""
CELL_M, LAYER_M, HEADINGS = 1.2, 2.0, 24
BEST = 3
"""So many times the cells that propose a place are looked at together with those beside them."""
NEAR_M = 2.0
"""A vote farther from any place of its building stands in no free space."""
_STEPS = 128
"""Distances are sorted to so many parts of a metre."""
_STRIDE = _STEPS * 16
_AT_ONCE = 2_000_000
"""Distances that are held at once."""
_BITS, _MIDDLE = 12, 64


@short_repr
@dataclass(frozen=True, eq=False)
class ObjectPairs:
    """Pairs of objects of one building, the first of the lower class (of one class: of the lower number).

    Args:
        first: (p,) number of an object.
        second: (p,) of another.
        kind: (p,) both classes in one number.
        metres: (p,) between them in the plane.

    """

    first: Ints
    second: Ints
    kind: Ints
    metres: Floats

    @classmethod
    def of(cls, positions: Floats, classes: Ints, n_classes: int) -> ObjectPairs:
        """All pairs in reach, of (k, 3) objects, metres, and their (k,) classes."""
        found = []
        for first, _, i, j, metres in Nearby(positions, positions, REACH_M, REACH_M).blocks():
            apart = metres >= LEAST_M
            at, j = nearest(i[apart] - first, j[apart], metres[apart])
            i = at + first
            low = (classes[i] < classes[j]) | ((classes[i] == classes[j]) & (i < j))
            # A pair that is among the nearest of one of them only is found from that one.
            found.append(np.where(low, (i, j), (j, i)))
        pairs = np.unique(np.concatenate([np.zeros((2, 0), np.int64), *found], axis=1), axis=1)
        i, j = pairs
        off = positions[j, :2] - positions[i, :2]
        metres = np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2)
        return cls(i, j, classes[i] * n_classes + classes[j], metres)


class PairVotes:
    """The pairs of all buildings of a map.

    Args:
        pairs: of each building.
        objects: (K, 3) of all buildings, metres.
        sizes: how many of them each building has.
        places: (M, 3) metres.
        building: (M,) of each place, rising.
        n_classes: C.

    """

    def __init__(
        self,
        pairs: Sequence[ObjectPairs],
        objects: Floats,
        sizes: Sequence[int],
        places: Floats,
        building: Ints,
        n_classes: int,
    ) -> None:
        self._n_classes = n_classes
        before = np.cumsum([0, *sizes])
        none = np.zeros(0, np.int64)
        first = np.concatenate([none, *(p.first + at for p, at in zip(pairs, before, strict=False))])
        second = np.concatenate([none, *(p.second + at for p, at in zip(pairs, before, strict=False))])
        keys = _key(
            np.concatenate([none, *(p.kind for p in pairs)]), np.concatenate([np.zeros(0), *(p.metres for p in pairs)])
        )
        order = np.argsort(keys, kind="stable")
        self._keys, first, second = keys[order], first[order], second[order]
        self._building = np.repeat(np.arange(len(pairs)), [len(p.first) for p in pairs])[order].astype(np.int64)
        at = objects[:, 0] + 1j * objects[:, 1]
        off = at[second] - at[first]
        self._heading, self._steps = off / np.maximum(np.abs(off), 1e-9), _steps(off)
        self._middle, self._height = (at[first] + at[second]) / 2, (objects[first, 2] + objects[second, 2]) / 2
        self._rise = objects[second, 2] - objects[first, 2]
        self._of_place = building
        self._at, self._start = places, np.searchsorted(building, np.arange(len(pairs) + 1))
        self._corner = np.zeros(len(pairs), dtype=np.complex128)
        for number, (low, size) in enumerate(zip(before, sizes, strict=False)):
            if size:
                x, y, _ = objects[low : low + size].min(axis=0)
                self._corner[number] = x + 1j * y

        self._table = PairTable(
            self._building,
            _parts(self._heading),
            self._steps,
            _parts(self._middle),
            self._height,
            self._rise,
            _parts(self._corner),
            self._start,
            *(np.ascontiguousarray(axis) for axis in places.T),
        )

    def rows(self, fragment: Fragment, most: int, only: NDArray[np.bool_] | None = None) -> Ints:
        """Places of the map where the most votes are, best first, each once.

        Args:
            fragment: what is around the robot.
            most: so many at most; 0: none.
            only: (M,) bool, the places that the robot can be at; None for all.

        """
        if not most:
            return np.zeros(0, dtype=np.int64)
        can = np.ones(len(self._corner), dtype=np.bool_)
        if only is not None:
            can = np.bincount(self._of_place[only], minlength=len(can)) > 0
        alike = self._alike(fragment)
        row = (self._compiled if compiled() else self._voted)(fragment, alike, can, most)
        row = row[row >= 0]
        if only is not None:
            row = row[only[row]]
        kept: Ints = np.array(list(dict.fromkeys(row.tolist())), dtype=np.int64)
        return kept

    def _voted(self, fragment: Fragment, alike: Alike, can: NDArray[np.bool_], kept: int) -> Ints:
        """(N,) the places nearest to the best cells, best first, of buildings that (B,) can be; -1 where none is."""
        hits, seen = self._hits(fragment, alike, can)
        if not len(hits):
            return np.zeros(0, dtype=np.int64)
        i, j, off, weight = alike.i, alike.j, alike.off.view(np.complex128)[:, 0], alike.worth[seen]
        here = fragment.objects[:, 0] + 1j * fragment.objects[:, 1]
        up = fragment.objects[:, 2]
        turn = self._heading[hits] * np.conj(off[seen])
        where = self._middle[hits] - turn * ((here[i] + here[j]) / 2)[seen]
        height = self._height[hits] - ((up[i] + up[j]) / 2)[seen]
        building = self._building[hits]
        heading = np.rint(self._steps[hits] - alike.steps[seen]).astype(np.int64) % HEADINGS
        cells = _cells(building, where - self._corner[building], height, heading)
        cell, of = np.unique(cells, return_inverse=True)
        votes = np.bincount(of, weight)
        most = np.argsort(-votes, kind="stable")[: BEST * kept]
        around = _beside(cell[most])
        at = np.minimum(np.searchsorted(cell, around), len(cell) - 1)
        total = np.where(cell[at] == around, votes[at], 0.0).sum(axis=1)
        best = most[np.argsort(-total, kind="stable")[:kept]]
        number = np.full(len(cell), -1)
        number[best] = np.arange(len(best))
        chosen = np.flatnonzero(number[of] >= 0)
        to, w = number[of[chosen]], weight[chosen]
        x, y, z = (np.bincount(to, w * v[chosen]) / votes[best] for v in (where.real, where.imag, height))
        first = np.zeros(len(best), dtype=np.int64)
        first[to] = building[chosen]
        return self._nearest(np.column_stack([x, y, z]), first)

    def _compiled(self, fragment: Fragment, alike: Alike, can: NDArray[np.bool_], kept: int) -> Ints:
        """As of `_voted`."""
        from semloc_core.matching.layout.compiled.votes import vote

        metres, numbers = (CELL_M, LAYER_M, HEIGHT_M, NEAR_M), (HEADINGS, BEST * kept, kept, _BITS, _MIDDLE)
        return vote(self._table, alike, np.ascontiguousarray(fragment.objects), can, metres, numbers)

    def _nearest(self, poses: Floats, building: Ints) -> Ints:
        """(N,) the nearest place of its building to each pose (N, 3), metres; -1 where none is near."""
        found = np.full(len(poses), -1, dtype=np.int64)
        for number in np.unique(building).tolist():
            places = self._at[self._start[number] : self._start[number + 1]]
            asked = np.flatnonzero(building == number)
            for part in np.array_split(asked, 1 + len(asked) * len(places) // _AT_ONCE) if len(places) else ():
                square = sum((np.subtract.outer(poses[part, k], places[:, k]) ** 2 for k in range(3)), np.zeros(1))
                best = square.argmin(axis=1)
                near = square[np.arange(len(part)), best] <= NEAR_M**2
                found[part[near]] = best[near] + self._start[number]
        return found

    def _alike(self, fragment: Fragment) -> Alike:
        """Which mapped pairs are like which seen ones."""
        objects, classes = fragment.objects[:VOTERS], fragment.classes[:VOTERS]
        i, j = np.triu_indices(len(classes), 1)
        swap = classes[i] > classes[j]
        i, j = np.where(swap, j, i), np.where(swap, i, j)
        # Of two objects of one class either may be the first.
        twice = classes[i] == classes[j]
        i, j = np.concatenate([i, j[twice]]), np.concatenate([j, i[twice]])
        at = objects[:, 0] + 1j * objects[:, 1]
        off = at[j] - at[i]
        metres = np.abs(off)
        use = (metres >= LEAST_M) & (metres <= REACH_M)
        i, j, off, metres = i[use], j[use], off[use], metres[use]
        kind = classes[i] * self._n_classes + classes[j]
        low = np.searchsorted(self._keys, _key(kind, np.maximum(metres - TOLERANCE_M, 0.0)))
        number = np.searchsorted(self._keys, _key(kind, metres + TOLERANCE_M), side="right") - low
        order = np.argsort(number, kind="stable")
        order = order[number[order] > 0]
        order = order[np.cumsum(number[order]) <= max(HITS, number[order[:1]].sum())]
        # Whole numbers: their sums are exact, whatever the order.
        worth = np.rint(16 * np.log1p(len(self._keys) / np.maximum(number, 1))).astype(np.int64)
        directions = _parts(off / np.maximum(metres, 1e-9))
        return Alike(i, j, directions, _steps(off), low, number, order, worth)

    def _hits(self, fragment: Fragment, alike: Alike, can: NDArray[np.bool_]) -> tuple[Ints, Ints]:
        """(H,) mapped pairs, and the numbers of the seen pairs that they are like."""
        order, up = alike.order, fragment.objects[:, 2]
        hits, seen = ranges(alike.low[order], alike.number[order]), np.repeat(order, alike.number[order])
        rise = up[alike.j] - up[alike.i]
        use = (np.abs(self._rise[hits] - rise[seen]) <= HEIGHT_M) & can[self._building[hits]]
        return hits[use], seen[use]


def _parts(points: NDArray[np.complex128]) -> Floats:
    """(…, 2) of complex numbers, the same memory."""
    return points.view(np.float64).reshape(-1, 2)


def _steps(off: NDArray[np.complex128]) -> Floats:
    found: Floats = np.angle(off) * (HEADINGS / (2 * np.pi))
    return found


def _key(kind: Ints, metres: Floats) -> Ints:
    found: Ints = kind * _STRIDE + np.minimum(metres * _STEPS, _STRIDE - 1).astype(np.int64)
    return found


def _cells(building: Ints, where: NDArray[np.complex128], height: Floats, heading: Ints) -> Ints:
    """(H,) numbers of cells. Round coordinates and quarter turns lie amid a cell: no last bit decides."""
    x, y = (
        np.clip(np.floor(v / CELL_M + 0.37), -_MIDDLE + 1, 2**_BITS - _MIDDLE - 2) for v in (where.real, where.imag)
    )
    z = np.clip(np.floor(height / LAYER_M + 0.37), -15, 14)
    found = (building << _BITS) + x.astype(np.int64) + _MIDDLE
    found = (found << _BITS) + y.astype(np.int64) + _MIDDLE
    found = (found << 5) + z.astype(np.int64) + 16
    return (found << 5) + heading


def _beside(cells: Ints) -> Ints:
    """(N, 27) cells and those beside them in the plane and by heading, on the same layer."""
    step = np.arange(-1, 2)
    heading = ((cells & 31)[:, None] + step) % HEADINGS
    plane = ((step[:, None] << (_BITS + 10)) + (step << 10)).ravel()
    found: Ints = ((cells & ~31)[:, None, None] + plane[:, None] + heading[:, None]).reshape(len(cells), -1)
    return found
