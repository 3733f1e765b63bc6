"""Distances along the traversability graph, which respect walls. Many places at a time are quicker with scipy.

Edge lengths are rounded to 2⁻³⁰ m (a nanometre), so that sums of them are exact in float64 (paths up to
8,000 km): a distance is then the same bits whichever way the path is walked and in whatever order edges came.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from semloc_core.wire import Position

_QUANTA_PER_METRE = float(2**30)
_CELLS_AT_ONCE = 1 << 23  # of the table source × place: 64 MiB


def edge_length(a: Position, b: Position) -> float:
    """Euclidean length of an edge in metres, rounded to 2⁻³⁰ m."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return round(math.sqrt(x * x + y * y + z * z) * _QUANTA_PER_METRE) / _QUANTA_PER_METRE


def edge_lengths(positions: NDArray[np.float64], edges: NDArray[np.int64]) -> NDArray[np.float64]:
    """(E,) lengths as of `edge_length`, bit by bit, of edges (2, E) between rows of positions (P, 3), metres."""
    # Written out: norm() may sum in another order, and round another way.
    x, y, z = (positions[edges[0]] - positions[edges[1]]).T
    lengths: NDArray[np.float64] = np.rint(np.sqrt(x * x + y * y + z * z) * _QUANTA_PER_METRE) / _QUANTA_PER_METRE
    return lengths


def connected(neighbours: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """The connected parts of a graph (place -> neighbouring places), each sorted, in the order of their first ids."""
    left, parts = set(neighbours), []
    for place in sorted(neighbours):
        if place in left:
            part, stack = {place}, [place]
            left.remove(place)
            while stack:
                fresh = left.intersection(neighbours[stack.pop()])
                left -= fresh
                part |= fresh
                stack += fresh
            parts.append(sorted(part))
    return parts


def ball(neighbours: Mapping[str, Mapping[str, float]], source: str, radius_m: float) -> dict[str, float]:
    """Geodesic distance (m) of every place at most ``radius_m`` from ``source``, by Dijkstra's algorithm.

    Args:
        neighbours: place -> {neighbouring place: edge length (m)}; a source without a row is alone.
        source: where to start; its own distance is 0.
        radius_m: bound, inclusive.

    """
    best = {source: 0.0}
    if source not in neighbours:
        return best
    known = best.get
    infinity = math.inf
    heap = [(0.0, source)]
    while heap:
        distance, place = heappop(heap)
        if distance > best[place]:
            continue  # an older, longer way to a place that has been settled since
        for other, length in neighbours[place].items():
            through = distance + length
            if through <= radius_m and through < known(other, infinity):
                best[other] = through
                heappush(heap, (through, other))
    return best


def repair(
    distances: dict[str, float],
    neighbours: Mapping[str, Mapping[str, float]],
    source: str,
    radius_m: float,
    touched: Iterable[str],
) -> set[str]:
    """Bring a `ball` up to date in place after a change to the graph; costs the part of it that changes.

    After Ramalingam and Reps, "On the computational complexity of dynamic graph problems" (1996): places that
    no shortest path supports any more are taken out, then Dijkstra's algorithm goes on from what borders on them
    and from what changed. Support is tested by equality, which is sound since the sums are exact.

    Args:
        distances: the ball as it was; changed in place.
        neighbours: the graph as it is now.
        source: centre of the ball; must still be a place.
        radius_m: bound, inclusive, the same as before.
        touched: places removed, and the ends of all edges that came, went or changed their length.

    Returns:
        Places whose distance is another one now, or that came in or fell out.

    """
    infinity, known = math.inf, distances.get
    touched = [place for place in touched if place in distances]
    before: dict[str, float | None] = {}
    work = [place for place in touched if place != source]
    while work:
        place = work.pop()
        if place in before:
            continue
        distance, row = distances[place], neighbours.get(place, {})
        # An edge of no length could make two places each other's only support.
        if any(w > 0.0 and u not in before and known(u, infinity) + w == distance for u, w in row.items()):
            continue
        before[place] = distance
        work += [u for u, w in row.items() if u != source and known(u) == distance + w]
    for place in before:
        del distances[place]
    heap: list[tuple[float, str]] = []
    # Only what may come to stand goes on the heap: where everything borders on everything, the rest fills it.
    for place in list(before):
        nearest = min((known(u, infinity) + w for u, w in neighbours.get(place, {}).items()), default=infinity)
        if nearest <= radius_m:
            heappush(heap, (nearest, place))
    for place in touched:
        if (at := known(place)) is not None:
            for other, length in neighbours[place].items():
                through = at + length
                if through <= radius_m and through < known(other, infinity):
                    heappush(heap, (through, other))
    while heap:
        distance, place = heappop(heap)
        if distance >= known(place, infinity):
            continue
        before.setdefault(place, known(place))
        distances[place] = distance
        for other, length in neighbours[place].items():
            through = distance + length
            if through <= radius_m and through < known(other, infinity):
                heappush(heap, (through, other))
    return {place for place, old in before.items() if known(place) != old}


def many_balls(
    n_places: int,
    edges: NDArray[np.int64],
    lengths: NDArray[np.float64],
    sources: NDArray[np.int64],
    radius_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Balls around many places at once, a slice of the sources at a time: the same with scipy and without.

    Args:
        n_places: P.
        edges: (2, E) place indices, each edge once.
        lengths: (E,) as of `edge_lengths`, metres.
        sources: (S,) place indices.
        radius_m: bound, inclusive.

    Returns:
        (M,) positions in ``sources``, (M,) place indices and (M,) distances in metres, by source, then place.

    """
    balls = _balls(n_places, edges, lengths, radius_m)
    found: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []
    slice_size = max(1, _CELLS_AT_ONCE // max(n_places, 1))
    for start in range(0, len(sources), slice_size):
        table = balls(sources[start : start + slice_size])
        rows, places = np.nonzero(np.isfinite(table))
        found.append((rows + start, places, table[rows, places]))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros(0)
    by_source, by_place, distances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return by_source, by_place, distances


def _balls(
    n_places: int, edges: NDArray[np.int64], lengths: NDArray[np.float64], radius_m: float
) -> Callable[[NDArray[np.int64]], NDArray[np.float64]]:
    """What makes of sources (S,) their distances (S, P), infinite beyond the radius."""
    try:
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import dijkstra
    except ModuleNotFoundError:
        return partial(relaxed, *_rows(n_places, edges, lengths), radius_m=radius_m)
    graph = csr_matrix((lengths, (edges[0], edges[1])), shape=(n_places, n_places))
    return lambda sources: dijkstra(graph, directed=False, indices=sources, limit=radius_m)


def _rows(
    n_places: int, edges: NDArray[np.int64], lengths: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(P, K) the neighbours of each place and the lengths (P, K) of the ways to them, filled up with endless ones."""
    ends, others = np.concatenate([edges, edges[::-1]], axis=1)
    order = np.argsort(ends, kind="stable")
    number = np.bincount(ends, minlength=n_places)
    row, column = ends[order], ranges(np.zeros(n_places, dtype=np.int64), number)
    neighbours = np.zeros((n_places, int(number.max(initial=0))), dtype=np.int64)
    ways = np.full(neighbours.shape, np.inf)
    neighbours[row, column], ways[row, column] = others[order], np.tile(lengths, 2)[order]
    return neighbours, ways


def relaxed(
    neighbours: NDArray[np.int64], ways: NDArray[np.float64], sources: NDArray[np.int64], radius_m: float
) -> NDArray[np.float64]:
    """(S, P) distances from sources, by Bellman and Ford: what came nearer is looked at from its neighbours again.

    Args:
        neighbours: (P, K) place indices.
        ways: (P, K) metres to them, infinite where there is none.
        sources: (S,) place indices.
        radius_m: bound, inclusive; what is beyond it is infinitely far.

    """
    metres = np.full((len(neighbours), len(sources)), np.inf)
    metres[sources, np.arange(len(sources))] = 0.0
    fresh = np.zeros(len(neighbours), dtype=np.bool_)
    fresh[sources] = True
    while fresh.any():
        rows = np.flatnonzero((fresh[neighbours] & np.isfinite(ways)).any(axis=1))
        nearest = metres[rows]
        for to, way in zip(neighbours[rows].T, ways[rows].T, strict=True):
            np.minimum(nearest, metres[to] + way[:, None], out=nearest)
        nearest[nearest > radius_m] = np.inf
        fresh[:] = False
        fresh[rows[(nearest < metres[rows]).any(axis=1)]] = True
        metres[rows] = nearest
    return np.ascontiguousarray(metres.T)


def ranges(start: NDArray[np.int64], size: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers start[0] … start[0] + size[0] - 1, then those of the next range, and so on."""
    ends = np.cumsum(size)
    numbers: NDArray[np.int64] = np.arange(ends[-1] if len(ends) else 0) + np.repeat(start - ends + size, size)
    return numbers
