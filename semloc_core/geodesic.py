"""Distances along the traversability graph, which respect walls. One place at a time without scipy, many with it.

Edge lengths are rounded to 2⁻³⁰ m (a nanometre), so that sums of them are exact in float64 (paths up to
8,000 km): a distance is then the same bits whichever way the path is walked and in whatever order edges came.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from semloc_core.wire import Position

_QUANTA_PER_METRE = float(2**30)


def edge_length(a: Position, b: Position) -> float:
    """Euclidean length of an edge in metres, rounded to 2⁻³⁰ m."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return round(math.sqrt(x * x + y * y + z * z) * _QUANTA_PER_METRE) / _QUANTA_PER_METRE


def edge_lengths(positions: NDArray[np.float64], edges: NDArray[np.int64]) -> NDArray[np.float64]:
    """(E,) lengths as of `edge_length`, bit by bit, of edges (2, E) between rows of positions (P, 3), metres."""
    # Written out: norm() may sum in another order, and round another way.
    x, y, z = (positions[edges[0]] - positions[edges[1]]).T
    lengths: NDArray[np.float64] = (
        np.rint(np.sqrt(x * x + y * y + z * z) * _QUANTA_PER_METRE) / _QUANTA_PER_METRE
    )
    return lengths


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
