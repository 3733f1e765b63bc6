"""What a map is good for, before a robot drives: which of its parts look alike, and how many objects a place has.

A *floor* is a storey of a building. A place has a double on a floor if a place there, too far away to be a right
answer, is at least as like it, by the map's own embeddings, as a right answer may be: as the least like quarter of the
places within 4 m. So a twin that was furnished a little differently is one too, and every encoder brings the measure
along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints, SceneGraph
from semloc_core.text import short_repr

FAR_M = 2 * MATCH_RADIUS_M
"""Beyond it a place of the same floor is another one, metres: no answer is right for both."""
SEEN_M = 5.0
"""What a robot sees from where it stands, metres, as simulated runs have it."""
ASKED = 1000
"""Places that are looked at, at most, evenly over the map."""
MOST_SEEN = 12
"""Nearest objects that a place is told by, at most."""
TWIN_SHARE = 0.7
"""Of the places of each of two floors that have doubles on the other, from which on the two are twins. Generated: 0.74
and more on twin buildings, as furnished and as a detector saw them, and twin storeys; 0.25 at most on others."""
LEAST_PLACES = 20
"""Of a storey that may be a twin of another of its building: a landing is like both storeys that it joins."""
_QUARTER, _SAME, _TIE = 0.25, 0.999, 1e-4
_BLOCK = 256


@short_repr
@dataclass(frozen=True, eq=False)
class LookAlikes:
    """What `look_alikes` finds; floors are numbered as given.

    Args:
        twins: groups of floors that look alike, each by rising number.
        doubled: (F,) of the places looked at on each floor, the share with a double on that same floor.
        near: (P,) objects within `SEEN_M` of each place.
        needed: how many of its nearest objects' classes tell a place from all that are elsewhere, everything as
            mapped: for half of the places, and for nine in ten; None where `MOST_SEEN` don't.

    """

    twins: list[list[int]]
    doubled: Floats
    near: Ints
    needed: tuple[int | None, int | None]


def look_alikes(
    embeddings: NDArray[np.float32], positions: Floats, floor: Ints, graphs: Sequence[tuple[int, SceneGraph]]
) -> LookAlikes:
    """Look for what a robot could mistake.

    Args:
        embeddings: (P, D), building after building.
        positions: (P, 3) metres, each in its building's frame.
        floor: (P,) from 0 on without a gap: building and storey.
        graphs: of each building how many places it has, and its scene graph.

    """
    building = np.repeat(np.arange(len(graphs)), [count for count, _ in graphs])
    shares = _doubles(embeddings, positions, floor, building)
    of = np.zeros(len(shares), dtype=np.int64)
    of[floor] = building
    landing = np.bincount(floor, minlength=len(shares)) < LEAST_PLACES
    joined = (of[:, None] == of) & (landing[:, None] | landing)
    pairs = np.argwhere((np.minimum(shares, shares.T) >= TWIN_SHARE) & ~joined).tolist()
    near, nearest = _objects(positions, floor, graphs)
    told = [_told_apart(nearest[:, :k], positions, floor) for k in range(1, MOST_SEEN + 1)]
    needed = [next((k for k, share in enumerate(told, start=1) if share >= most), None) for most in (0.5, 0.9)]
    return LookAlikes(_groups(pairs, len(shares)), np.diag(shares).copy(), near, (needed[0], needed[1]))


def _doubles(embeddings: NDArray[np.float32], positions: Floats, floor: Ints, building: Ints) -> Floats:
    """(F, F): of the places looked at on the first floor, the share with a double on the second.

    Places whose embedding is nothing, as where no object is in reach, are like none.
    """
    size = np.linalg.norm(embeddings, axis=1)
    z = embeddings / np.maximum(size, np.finfo(np.float32).tiny)[:, None]
    order = np.argsort(floor, kind="stable")
    first = np.searchsorted(floor[order], np.arange(int(floor.max(initial=-1)) + 1))
    shares, seen = np.zeros((len(first), len(first))), np.zeros(len(first))
    rows = np.unique(np.linspace(0, max(len(z) - 1, 0), min(len(z), ASKED)).round().astype(np.int64))
    for start in range(0, len(rows), _BLOCK):
        asked = rows[start : start + _BLOCK]
        like = np.where(size[order] > 0, z[asked] @ z[order].T, -1.0)
        same = building[asked][:, None] == building[order]
        home = floor[asked][:, None] == floor[order]
        apart = metres_between(positions[asked], positions[order])
        right = home & (apart <= MATCH_RADIUS_M) & (asked[:, None] != order)
        own = np.array(
            [np.quantile(row[near], _QUARTER) if near.any() else 0.0 for row, near in zip(like, right, strict=True)]
        )
        own = np.where(own > 0, own, _SAME)
        best = np.maximum.reduceat(
            np.where(same & (apart <= np.where(home, FAR_M, MATCH_RADIUS_M)), -1.0, like), first, axis=1
        )
        doubled = (best >= own[:, None] - _TIE) & (size[asked] > 0)[:, None]
        np.add.at(shares, floor[asked], doubled)
        np.add.at(seen, floor[asked], 1)
    found: Floats = shares / np.maximum(seen, 1)[:, None]
    return found


def metres_between(points: Floats, others: Floats) -> Floats:
    """(A, B) distances between points (A, 3) and others (B, 3)."""
    squared = np.zeros((len(points), len(others)))
    for axis in range(points.shape[1]):
        squared += (points[:, axis, None] - others[:, axis]) ** 2
    return np.sqrt(squared, out=squared)


def _groups(pairs: Sequence[Sequence[int]], floors: int) -> list[list[int]]:
    """Floors that are joined by pairs, directly or by way of others."""
    number = np.arange(floors)
    for a, b in pairs:
        number[number == max(number[a], number[b])] = min(number[a], number[b])
    groups = [np.flatnonzero(number == k).tolist() for k in np.unique(number)]
    return [group for group in groups if len(group) > 1]


def _objects(
    positions: Floats, floor: Ints, graphs: Sequence[tuple[int, SceneGraph]]
) -> tuple[Ints, NDArray[np.uint64]]:
    """Objects within `SEEN_M` of each place (P,), and the codes of the classes of its nearest ones (P, MOST_SEEN).

    An object is on the floor of the place nearest to it, and no place of another sees it. The codes of several add up
    to one number for each multiset, but for one chance in 2^64; 0 stands for no object.
    """
    near, nearest = np.zeros(len(positions), dtype=np.int64), np.zeros((len(positions), MOST_SEEN), dtype=np.uint64)
    classes = sorted({item.class_ for _, graph in graphs for item in graph.objects.values()})
    drawn = np.random.default_rng(0).integers(1, 2**64, len(classes), dtype=np.uint64)
    code, start = dict(zip(classes, drawn, strict=True)), 0
    for count, graph in graphs:
        rows, start = np.arange(start, start + count), start + count
        if not graph.objects or not count:
            continue
        items = [graph.objects[id_] for id_ in sorted(graph.objects)]
        at = np.array([item.position for item in items])
        codes = np.array([code[item.class_] for item in items], dtype=np.uint64)
        on = floor[rows][_nearest(at, positions[rows], 1)[0][:, 0]]
        for number in np.unique(on).tolist():
            here, own = rows[floor[rows] == number], on == number
            found, near[here] = _nearest(positions[here], at[own], MOST_SEEN)
            nearest[here] = np.append(codes[own], np.uint64(0))[found]
    return near, nearest


def _nearest(points: Floats, others: Floats, most: int) -> tuple[Ints, Ints]:
    """(A, most) rows of the others nearest to each point, -1 where there are no more; (A,) how many are in sight."""
    found, seen = np.full((len(points), most), -1, dtype=np.int64), np.zeros(len(points), dtype=np.int64)
    for start in range(0, len(points), _BLOCK):
        apart = metres_between(points[start : start + _BLOCK], others)
        near = np.argsort(apart, axis=1, kind="stable")[:, :most]
        found[start : start + _BLOCK, : near.shape[1]] = near
        seen[start : start + _BLOCK] = (apart <= SEEN_M).sum(axis=1)
    return found, seen


def _told_apart(codes: NDArray[np.uint64], positions: Floats, floor: Ints) -> float:
    """The share of places whose objects (P, k) are like those of no place elsewhere."""
    if not len(codes):
        return 0.0
    _, kind = np.unique(codes.sum(axis=1, dtype=np.uint64), return_inverse=True)
    order = np.argsort(kind, kind="stable")
    first = np.searchsorted(kind[order], np.arange(int(kind.max()) + 1))
    at = np.column_stack([positions, floor])[order]
    extent = np.maximum.reduceat(at, first) - np.minimum.reduceat(at, first)
    spot = (np.linalg.norm(extent[:, :3], axis=1) <= FAR_M) & (extent[:, 3] == 0)
    return float((spot[kind] & codes.any(axis=1)).mean())
