"""What speaks against a pose, compiled: `pose.expected_objects` and `building.free_space_cost`, one pose after another.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import Floats32, Looked, MapTable


@kernel
def expected(table: MapTable, looked: Looked, rows: Ints, pose: Floats) -> Floats:
    """(T,) how many mapped objects near known places would be detected, as of `pose.expected_objects.expected`.

    Args:
        table: the map.
        looked: where the robot has.
        rows: (T,) of the map.
        pose: (T, 4) cosine and sine of the turn, shift in x and y.

    """
    found = np.zeros(len(rows))
    nx, ny, nz = looked.cells.shape
    low_x, low_y, low_z = looked.low
    # Cells are as wide as a power of two: a product is the quotient, to the bit.
    per_x, per_y, per_z = 1.0 / looked.cell_m[0], 1.0 / looked.cell_m[1], 1.0 / looked.cell_m[2]
    for t in range(len(rows)):
        row = rows[t]
        c, s, dx, dy = pose[t]
        px, py, pz = table.x[row] + dx, table.y[row] + dy, table.z[row]
        for e in range(table.start[row], table.start[row + 1]):
            o = table.objects[e]
            ox, oy, oz = table.object_x[o] - px, table.object_y[o] - py, table.object_z[o] - pz
            iz = _cell((oz - low_z) * per_z, looked.rim, nz)
            ix = _cell((c * ox + s * oy - low_x) * per_x, looked.rim, nx)
            iy = _cell((c * oy - s * ox - low_y) * per_y, looked.rim, ny)
            if looked.cells[ix, iy, iz]:
                found[t] += table.detected[o]
    return found


@kernel
def lost(
    building: Ints,
    turn: Floats,
    origin: Floats,
    places: Floats,
    low: Floats,
    shape: Ints,
    first: Ints,
    cost: Floats32,
    rim: int,
    cell_m: tuple[float, float],
) -> Floats:
    """(T,) cost of known places where a building has no room, as of `building.free_space_cost.Rooms.lost`.

    Args:
        building: (T,) of each pose.
        turn: (T, 2) cosine and sine.
        origin: (T, 3) metres.
        places: (k, 3) metres from there.
        low, shape, first: (B, 3), (B, 3), (B,) of each building's cells.
        cost: of all cells.
        rim: cells around all.
        cell_m: width and height of a cell, metres.

    """
    total = np.zeros(len(building))
    wide, high = cell_m
    for t in range(len(building)):
        b, c, s = building[t], turn[t, 0], turn[t, 1]
        nx, ny, nz = shape[b]
        px, py = (origin[t, 0] - low[b, 0]) / wide + rim, (origin[t, 1] - low[b, 1]) / wide + rim
        pz, low_z, begin = origin[t, 2], low[b, 2], first[b]
        c, s = c / wide, s / wide
        for i in range(len(places)):
            x, y = places[i, 0], places[i, 1]
            column = _cell(c * x - s * y + px, 0, nx)
            line = _cell(s * x + c * y + py, 0, ny)
            layer = _cell((pz + places[i, 2] - low_z) / high, rim, nz)
            total[t] += cost[begin + (column * ny + line) * nz + layer]
    return total


@kernel
def _cell(at: float, rim: int, size: int) -> int:
    return int(min(max(math.floor(at) + rim, 0.0), size - 1.0))
