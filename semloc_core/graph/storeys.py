"""Which storey a place is on: derived once for a building, when it is mapped, from how high its floors lie.

A place's own height does not say it: places float in the free space, and those of one floor may span metres. What does
is what is around it. The level of a place is the middle height of the places that can be reached from it by edges that
do not climb, without going far in the plane: what floats above one another on one floor has one level, while what a
slab parts is not reached. Levels of a floor lie together; between floors there are only those of stairs and landings. A
cut between two heaps of levels makes two storeys where the heaps are far enough apart (a few steps up are none), few
levels lie between, and few edges lead across without climbing (a high hall is joined to what is beside it all along, an
upper floor by its stairs). Beside stairs levels mislead: there a place goes with the storey whose places a walk along
the edges meets first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph.scene_graph import SceneGraph

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

AROUND_M = 2.5
"""How far in the plane the places lie whose heights make a level."""
CLIMB_M = 0.8
"""An edge that rises by more is a flight of stairs: what is beyond does not tell a level."""
APART_M = 1.0
"""Floors lie at least so far apart: what is nearer is a few steps up or down on one storey."""
LEAST_PLACES, LEAST_SHARE = 8, 0.03
"""A heap of fewer places, or of a smaller share of them, is a landing: it goes to the storey nearest in height."""
SWEEPS = 200
"""How often the chances of places beside stairs are averaged over their neighbours."""
BESIDE_M = 2.0
"""Places so near in the plane say where a storey is at a point."""
ABOVE = 2.0
"""How much more a metre above a storey's places counts than one below."""
BETWEEN_M = 0.5
"""A storey that is so little further than another one is as likely to be called a point's."""
STOREYS_NEAR = BESIDE_M, ABOVE, BETWEEN_M
MOST_APART = 1024
"""Numbers of storeys of one building beyond which `separate` does not count through all that may be."""
STEP_M = 0.05
SMOOTH_M = 0.2
"""Standard deviation by which levels are smeared before heaps are looked for."""
VALLEY = 0.3
"""Between two storeys levels are at most so dense, as a share of the peak of the lower heap."""
ACROSS = 0.5
"""At most so many edges lead across a cut, as a share of the places on its smaller side."""


def storeys(positions: Floats, edges: Ints) -> Ints:
    """(P,) int64, the storey of each place of a building: 0 for the lowest, rising; all 0 where there is one.

    Args:
        positions: (P, 3) metres.
        edges: (2, E) traversability edges.

    """
    least = max(LEAST_PLACES, int(np.ceil(LEAST_SHARE * len(positions))))
    if len(positions) < 2 * least:
        return np.zeros(len(positions), dtype=np.int64)
    level_edges = edges[:, np.abs(positions[edges[0], 2] - positions[edges[1], 2]) <= CLIMB_M]
    around = _around(positions[:, :2], level_edges)
    level = np.array([np.median(positions[near, 2]) for near in around])
    cuts = _cuts(level, level_edges, least)
    found = np.searchsorted(np.array(cuts), level).astype(np.int64)
    return _settled(found, around, edges) if cuts else found


def storeys_of(graph: SceneGraph) -> dict[str, int]:
    """The storey of each place of a scene graph (`storeys`)."""
    ids = sorted(graph.places)
    number = {id_: i for i, id_ in enumerate(ids)}
    edges = sorted((number[a], number[b]) for a, row in graph.neighbours.items() for b in row if a < b)
    positions = np.array([graph.places[id_] for id_ in ids], dtype=np.float64).reshape(-1, 3)
    found = storeys(positions, np.array(edges, dtype=np.int64).reshape(-1, 2).T)
    return dict(zip(ids, found.tolist(), strict=True))


def storey_at(point: Floats, positions: Floats, storey: Ints) -> int:
    """The storey that a point of a building is on, such as where a robot truly is.

    It is the one whose places around there, in the plane, span its height, or lie nearest to it in height; a point just
    below these is on it rather than one just above (a robot's height may be that of its base, on the floor).

    Args:
        point: (3,) metres.
        positions: (P, 3) of the building's mapped places, one at least.
        storey: (P,) theirs.

    """
    return _first(_beside(point, positions, storey))


def storeys_at(point: Floats, positions: Floats, storey: Ints) -> list[int]:
    """The storeys that a point may be said to be on, that of `storey_at` first: several between floors, as on stairs.

    There they hang on whether a robot's height is its base's, and on centimetres.

    Args:
        point, positions, storey: as of `storey_at`.

    """
    beside = _beside(point, positions, storey)
    found: set[int] = set()
    for above in (1.0, ABOVE):
        least = min(_cost(there, above) for there in beside)
        found.update(there[4] for there in beside if round(_cost(there, above) - least, 6) <= BETWEEN_M)
    first = _first(beside)
    return [first, *sorted(found - {first})]


Beside = tuple[float, float, float, float, int]
"""How far a storey's places begin in the plane, and from the height of those around there on, above a point and below
it; how far the nearest is; the storey."""


def _beside(point: Floats, positions: Floats, storey: Ints) -> list[Beside]:
    """Each storey as a point has it."""
    away = np.hypot(positions[:, 0] - point[0], positions[:, 1] - point[1])
    found = []
    for k in np.unique(storey).tolist():
        here = np.flatnonzero(storey == k)
        nearest = float(away[here].min())
        heights = positions[here[away[here] <= max(BESIDE_M, nearest + 1.0)], 2]
        off = round(float(np.linalg.norm(positions[here] - point, axis=1).min()), 6)
        found.append((nearest, float(heights.min() - point[2]), float(point[2] - heights.max()), off, int(k)))
    return found


def _first(beside: list[Beside]) -> int:
    return min((round(_cost(there, ABOVE), 6), *there[3:]) for there in beside)[2]


def _cost(there: Beside, above: float) -> float:
    """How far a storey is, metres, if one above its places counts so many times."""
    nearest, below, over, _, _ = there
    return float(np.hypot(nearest, max(below, above * over, 0.0)))


def separate(building: NDArray[np.integer[Any]], storey: Ints) -> NDArray[np.int32]:
    """(M,) numbers of the storeys of several buildings: equal for places on one storey of one building."""
    if not len(storey):
        return np.zeros(0, dtype=np.int32)
    low, span = int(storey.min()), int(storey.max() - storey.min()) + 1
    if span > MOST_APART:  # none of a real building: not so many numbers are held
        both = np.stack([building, storey], axis=1)
        return np.unique(both, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)
    number = building.astype(np.int64) * span + (storey - low)
    there = np.zeros(int(number.max()) + 1, dtype=np.bool_)
    there[number] = True
    found: NDArray[np.int32] = (np.cumsum(there, dtype=np.int32) - np.int32(1))[number]
    return found


def _around(flat: Floats, edges: Ints) -> list[Ints]:
    """For each of (P, 2) places those that are reached from it within `AROUND_M` in the plane, itself among them."""
    joined: list[list[int]] = [[] for _ in range(len(flat))]
    for a, b in edges.T.tolist():
        joined[a].append(b)
        joined[b].append(a)
    x, y = flat.T
    found = []
    for place in range(len(flat)):
        inside = (x - x[place]) ** 2 + (y - y[place]) ** 2 <= AROUND_M**2
        near, todo = {place}, [place]
        while todo:
            for other in joined[todo.pop()]:
                if inside[other] and other not in near:
                    near.add(other)
                    todo.append(other)
        found.append(np.array(sorted(near), dtype=np.int64))
    return found


def _cuts(level: Floats, edges: Ints, least: int) -> list[float]:
    """Levels, rising, between which storeys lie."""
    order = np.argsort(level, kind="stable")
    rank = np.empty(len(level), dtype=np.int64)
    rank[order] = np.arange(len(level))
    ordered = level[order]
    low, high = np.sort(rank[edges], axis=0)
    height = np.arange(ordered[0], ordered[-1] + STEP_M, STEP_M)
    off = (height[:, None] - ordered) / SMOOTH_M
    density = np.exp(-0.5 * off * off).sum(axis=1)
    cuts: list[float] = []
    todo = [(0, len(level))]
    while todo:
        first, last = todo.pop()
        # (density there, level, places below) of each cut that makes two storeys of places first … last - 1.
        found: list[tuple[float, float, int]] = []
        here = np.flatnonzero((height >= ordered[first]) & (height <= ordered[last - 1]))
        for i in here[1:-1].tolist():
            valley, cut = float(density[i]), float(height[i])
            if valley > min(density[i - 1], density[i + 1]):
                continue
            middle = int(np.searchsorted(ordered, cut))
            if middle - first < least or last - middle < least:
                continue
            across = ((low >= first) & (low < middle) & (high >= middle) & (high < last)).sum()
            apart = np.median(ordered[middle : middle + least]) - np.median(ordered[middle - least : middle])
            peak = min(density[here[0] : i].max(), density[i + 1 : here[-1] + 1].max())
            if apart >= APART_M and valley <= VALLEY * peak and across <= ACROSS * min(middle - first, last - middle):
                found.append((valley, cut, middle))
        if found:
            _, cut, middle = min(found)
            cuts.append(cut)
            todo += [(first, middle), (middle, last)]
    return sorted(cuts)


def _settled(found: Ints, around: list[Ints], edges: Ints) -> Ints:
    """(P,) storeys, of places beside stairs by which storey a random walk along the edges meets first."""
    alike = np.array([(found[near] == found[place]).all() for place, near in enumerate(around)])
    sure = np.array([alike[near].all() for near in around])
    # A heap of levels that are all mixed, of places at the foot and the head of stairs, is no storey.
    known = np.unique(found[sure])
    if len(known) < 2:
        return np.zeros_like(found)
    chance = (found[:, None] == known).astype(np.float64)
    first = 1e-6 * chance
    doubt = np.flatnonzero(~sure)
    a, b = np.concatenate([edges, edges[::-1]], axis=1)
    led = ~sure[a]
    a, b = a[led], b[led]
    links = np.bincount(a, minlength=len(found))[doubt, None] + 1e-6
    for _ in range(SWEEPS if len(doubt) else 0):
        met = np.stack([np.bincount(a, row[b], len(found)) for row in chance.T], axis=1) + first
        chance[doubt] = met[doubt] / links
    settled: Ints = np.round(chance, 6).argmax(axis=1).astype(np.int64)
    return settled
