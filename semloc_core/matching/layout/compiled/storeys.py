"""The storeys that points may be said to be on, compiled: `graph.storeys_at` for many points of several buildings.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import Ints32, MapTable


@kernel
def storeys_of(
    table: MapTable,
    points: Floats,
    rows: Ints,
    storey: Ints32,
    first: Ints32,
    number: Ints,
    radius_m: float,
    numbers: tuple[float, float, float],
) -> Ints:
    """(A, most) the storeys that each point may be said to be on, the likeliest first; -1 where there are no more.

    Args:
        table: the map.
        points: (A, 3) metres.
        rows: (A,) of the map, a place of each point's building that counts whatever its distance.
        storey: (M,) of the places.
        first, number: (B,) each building's lowest storey, and how many it has: they are numbered through.
        radius_m: places further in the plane, along either axis, don't count.
        numbers: `BESIDE_M`, `ABOVE` and `BETWEEN_M` of `graph.storeys`.

    """
    beside_m, above, between_m = numbers
    most = number.max()
    found = np.full((len(points), most), -1, np.int64)
    nearest, off, low, high = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    reach = np.empty(most)
    mild, strict, taken = np.empty(most), np.empty(most), np.empty(most, np.bool_)
    for a in range(len(points)):
        b, row = table.building[rows[a]], rows[a]
        base, n = first[b], number[b]
        if n == 1:
            found[a, 0] = base
            continue
        px, py, pz = points[a]
        nearest[:], off[:], low[:], high[:], taken[:] = np.inf, np.inf, np.inf, -np.inf, False
        for again in range(2):
            for i in range(table.place_start[b], table.place_start[b + 1]):
                ax, ay, az = abs(table.x[i] - px), abs(table.y[i] - py), table.z[i] - pz
                if (ax > radius_m or ay > radius_m) and i != row:
                    continue
                s, away = storey[i] - base, ax * ax + ay * ay
                if not again:
                    nearest[s] = min(nearest[s], away)
                    off[s] = min(off[s], away + az * az)
                elif away <= reach[s]:
                    low[s], high[s] = min(low[s], table.z[i]), max(high[s], table.z[i])
            for s in range(n if not again else 0):
                nearest[s], off[s] = math.sqrt(nearest[s]), math.sqrt(off[s])
                reach[s] = max(beside_m, nearest[s] + 1.0) ** 2
        for s in range(n):
            below, over = low[s] - pz, pz - high[s]
            mild[s] = math.hypot(nearest[s], max(below, over, 0.0))
            strict[s] = math.hypot(nearest[s], max(below, above * over, 0.0))
        best = -1
        for s in range(n):
            if nearest[s] < np.inf and (best < 0 or _before(strict, off, s, best)):
                best = s
        found[a, 0], taken[best] = base + best, True
        many, least, least_strict = 1, mild[:n].min(), strict[:n].min()
        for s in range(n):
            if taken[s] or nearest[s] == np.inf:
                continue
            if _micro(mild[s] - least) <= between_m or _micro(strict[s] - least_strict) <= between_m:
                found[a, many] = base + s
                many += 1
    return found


@kernel
def _micro(value: float) -> float:
    """To a millionth: no last bit decides."""
    return float(np.rint(value * 1e6) / 1e6)


@kernel
def _before(cost: Floats, off: Floats, one: int, other: int) -> bool:
    """Whether a storey comes before another: by its cost, then by how far its nearest place is, then by number."""
    mine, its = _micro(cost[one]), _micro(cost[other])
    if mine != its:
        return bool(mine < its)
    return bool(_micro(off[one]) < _micro(off[other]))
