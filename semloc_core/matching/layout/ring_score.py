"""How well every place of a map could account for what is around the robot, by distance alone.

A similarity punishes a fragment for what has not been seen yet. Here the places that the robot knows say how far it
has looked: in ring r around the robot it knows e_r places, and has seen q_cr objects of class c there. A place of the
map has m_cr objects and n_r places in the same ring, so that so much looking should have shown e_r · λ_cr of them, with
a rate λ_cr = detected · m_cr / (n_r + 1) + invented_c. Seen counts are taken as Poisson (inhomogeneous Poisson process,
its exposure the known places):

    log P(q | place) = Σ_cr q_cr log λ_cr − Σ_r e_r Σ_c λ_cr − shape · Σ_r max(0, e_r − slack · n_r − 1) + constant

The last term refuses places around which the map has less room than the robot has found. The rings are soft, and laid
by distance as the crow flies: a fragment does not know the short cuts yet, so that distances along its edges are too
long, while straight ones are what they will remain.
What a building has in its rings is counted once for it; logarithms are taken when a class is first seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.building.objects_by_place import sums
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.text import short_repr

RING_CENTRES_M = np.array([0.0, 2.0, 4.0, 6.0, 8.5, 11.5])
RING_WIDTHS_M = np.array([1.0, 1.0, 1.0, 1.2, 1.5, 1.8])
MOST_PLACES = 50_000
"""A map with more places is not scanned: the embedding alone proposes."""
MOST_COUNTS = 8_000_000
"""Places times classes: a scan takes some 24 bytes for each, and as many again while it is made."""
STEP_M = 0.01
"""Shares of rings are tabled in such steps: there are many more pairs than steps."""
_FAINT = 1e-9
"""A smaller share of an object in a ring changes no likelihood."""
DECIMALS = 6
"""Names of which as much is known, to so many decimals of what they may be, are one."""
MOST_NAMES = 16
"""Names of several classes whose rates are kept at most."""
DETECTED = 0.77
"""Share of the mapped objects that are detected."""
INVENTED = 0.04
"""Objects seen for each known place that the map does not have."""
SHAPE, SLACK = 0.3, 1.3
"""Log-likelihood lost for each place more than so many times what the map has room for."""


@short_repr
@dataclass(frozen=True, eq=False)
class Rings:
    """What is around m places of a building, ring by ring.

    Args:
        classes: (c,) the classes of objects around them.
        rate: (c, R, m) float32, objects of each of these to be detected for each place known in the ring.
        total: (R, m) float32, the same of all classes.
        room: (R, m) float32, places that may be known there without any doubt.
        near: (C,) objects of each class, counted once from each place in reach.

    """

    classes: Ints
    rate: NDArray[np.float32]
    total: NDArray[np.float32]
    room: NDArray[np.float32]
    near: Floats


class RingCounter:
    """Counts what is around the places of one building, block by block.

    Args:
        n_places: m.
        n_classes: C.
        reach_m: how far.

    """

    def __init__(self, n_places: int, n_classes: int, reach_m: float) -> None:
        self._objects = np.zeros((n_classes, len(RING_CENTRES_M), n_places), dtype=np.float32)
        self._places = np.zeros((len(RING_CENTRES_M), n_places), dtype=np.float32)
        shares = _shares(STEP_M * (np.arange(round(reach_m / STEP_M) + 1, dtype=np.float64) + 0.5))
        self._shares = np.ascontiguousarray(shares.T)

    def count_objects(self, rows: slice, of: Ints, metres: Floats, classes: Ints, weight: Floats) -> None:
        """Add K objects: the row each is near (of those given, from 0), how far, its class, whether it is there."""
        shares = self._shares[_step(metres)] * weight[:, None]
        c, n = len(self._objects), rows.stop - rows.start
        at = classes * n + of
        for ring in range(len(RING_CENTRES_M)):
            self._objects[:, ring, rows] = np.bincount(at, shares[:, ring], n * c).reshape(c, n)

    def count_places(self, rows: slice, of: Ints, metres: Floats) -> None:
        """Add K places: the row each is near, and how far."""
        n, steps = rows.stop - rows.start, len(self._shares)
        counts = np.bincount(of * steps + _step(metres), minlength=n * steps).reshape(n, steps)
        self._places[:, rows] = (counts @ self._shares).T

    def rings(self) -> Rings:
        """What was counted."""
        near = self._objects.sum(axis=(1, 2), dtype=np.float64)
        classes = np.flatnonzero(near)
        rate = self._objects[classes]
        rate *= np.float32(DETECTED)
        rate /= self._places + np.float32(1.0)
        return Rings(classes, rate, rate.sum(axis=0), np.float32(SLACK) * self._places + np.float32(1.0), near)


class CoarseScan:
    """Scans all places of a map.

    Args:
        buildings: their rings, in the order of the map's rows.

    """

    def __init__(self, buildings: Sequence[Rings]) -> None:
        near = np.sum([rings.near for rings in buildings], axis=0)
        # Each building counts by its objects; a class that no map has can be invented too.
        frequency = (near / max(near.sum(), 1.0) + 0.1 / len(near)) / 1.1
        self._invented = np.float32(INVENTED) * frequency.astype(np.float32)
        self._total = np.concatenate([rings.total for rings in buildings], axis=1)
        self._total += self._invented.sum(dtype=np.float32)
        self._room = np.concatenate([rings.room for rings in buildings], axis=1)
        rate = np.zeros((len(near), *self._room.shape), dtype=np.float32)
        first = 0
        for rings in buildings:
            rate[rings.classes, :, first : first + rings.rate.shape[2]] = rings.rate
            first += rings.rate.shape[2]
        self._rate = rate.reshape(-1, first)
        # Which rows of it are logarithms already: those of the classes that were seen yet.
        self._logged = np.zeros(len(self._rate), dtype=np.bool_)
        self._mixed: dict[bytes, NDArray[np.float32]] = {}
        self._lock = Lock()

    def log_likelihood(self, fragment: Fragment) -> NDArray[np.float32]:
        """(M,) of each place of the map, up to a constant; equal ones of places with equal surroundings.

        What may be of several classes, or has no name, may be any object of these: their rates add up, each by how
        often its class is called so.
        """
        found = self._sure(sure := fragment.sure())
        if len(sure.classes) < len(fragment.classes):
            assert fragment.likely is not None
            shares = _shares(_metres(fragment.objects))
            certain = set(sure.object_ids)
            unsure = [i for i, id_ in enumerate(fragment.object_ids) if id_ not in certain]
            names, of = np.unique(np.round(fragment.likely[unsure], DECIMALS), axis=0, return_inverse=True)
            for number, name in enumerate(names):
                seen = shares[:, unsure][:, of.reshape(-1) == number].sum(axis=1)
                found += np.einsum("r,rm->m", seen, self._of_several(name))
        return found

    def _of_several(self, name: Floats) -> NDArray[np.float32]:
        """(R, M) logarithm of the rate of what is called by a name that may be of classes (C + 1,), as a fragment's."""
        if (found := self._mixed.get(key := name.tobytes())) is None:
            rings, named = len(RING_CENTRES_M), name[:-1]
            of = np.flatnonzero(named) if named.any() else np.arange(len(named))
            often = self._invented[of] / np.float32(INVENTED)
            weight = (named[of] / often if named.any() else np.ones(len(of))).astype(np.float32)
            rate = np.full(self._room.shape, (weight * self._invented[of]).sum(), dtype=np.float32)
            with self._lock:
                for class_, times in zip(of.tolist(), weight.tolist(), strict=True):
                    rows = slice(class_ * rings, (class_ + 1) * rings)
                    own = self._rate[rows].copy()
                    logged = self._logged[rows]
                    own[logged] = np.exp(own[logged]) - self._invented[class_]
                    rate += np.float32(times) * own
            found = np.log(rate, out=rate)
            if len(self._mixed) >= MOST_NAMES:
                self._mixed.clear()
            self._mixed[key] = found
        return found

    def _sure(self, fragment: Fragment) -> NDArray[np.float32]:
        """The same of objects that are of their class."""
        rings = len(RING_CENTRES_M)
        of = (fragment.classes * rings + np.arange(rings)[:, None]).ravel()
        shares = _shares(_metres(fragment.objects)).ravel()
        seen = sums(of, shares, len(self._rate)).astype(np.float32)
        at = np.flatnonzero(seen > _FAINT)
        self._take_logarithms(at[~self._logged[at]])
        known = _shares(_metres(fragment.places)).sum(axis=1)
        if compiled():
            from semloc_core.matching.layout.compiled.scan import scan

            return scan(at, seen[at], self._rate, known, self._total, self._room, np.float32(SHAPE))
        found: NDArray[np.float32] = np.einsum("k,km->m", seen[at], self._rate.take(at, axis=0))
        found -= np.einsum("r,rm->m", known, self._total)
        for e, room in zip(known, self._room, strict=True):
            found -= np.float32(SHAPE) * np.maximum(e - room, np.float32(0.0))
        return found

    def _take_logarithms(self, rows: Ints) -> None:
        with self._lock:
            for row in rows[~self._logged[rows]].tolist():
                rate = self._rate[row] + self._invented[row // len(RING_CENTRES_M)]
                self._rate[row] = np.log(rate, out=rate)
                self._logged[row] = True


def affordable(n_places: int, n_classes: int) -> bool:
    """Whether a scan of such a map is neither slow nor large."""
    return n_places <= MOST_PLACES and n_places * n_classes <= MOST_COUNTS


def _step(metres: Floats) -> Ints:
    return (metres / STEP_M).astype(np.int64)


def _metres(offsets: Floats) -> Floats:
    found: Floats = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return found


def _shares(metres: Floats) -> NDArray[np.float32]:
    """(R, K) float32 shares of K distances (m) in the rings; those of each distance sum to 1."""
    weight = -0.5 * ((metres - RING_CENTRES_M[:, None]) / RING_WIDTHS_M[:, None]) ** 2
    weight -= weight.max(axis=0)
    np.exp(weight, out=weight)
    weight /= weight.sum(axis=0)
    found: NDArray[np.float32] = weight.astype(np.float32)
    return found
