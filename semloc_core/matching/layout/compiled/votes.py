"""Pairs of objects that vote for places, compiled: `pair_votes.PairVotes`, one hit after another.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import Alike, Bools, PairTable


@kernel
def vote(
    table: PairTable,
    alike: Alike,
    objects: Floats,
    can: Bools,
    metres: tuple[float, float, float, float],
    numbers: tuple[int, int, int, int, int],
) -> Ints:
    """(N,) the place of the map nearest to each of the best cells, best first; -1 where none is near.

    Args:
        table: the map.
        alike: seen pairs.
        objects: (n, 3) seen, metres.
        can: (B,) whether the robot may be in a building.
        metres, numbers: constants of `pair_votes`.

    """
    i, j, off, steps, low, number, order, worth = alike
    cell_m, layer_m, height_m, near_m = metres
    headings, most, kept, bits, middle = numbers
    hits = 0
    for pair in order:
        hits += number[pair]
    size = 1024
    while size < 2 * hits:
        size *= 2
    keys, votes = np.full(size, -1, np.int64), np.zeros(size, np.int64)
    x, y, z, slot_of, weight = np.empty(hits), np.empty(hits), np.empty(hits), np.empty(hits, np.int64), np.empty(hits)
    of = np.empty(hits, np.int64)
    cells = np.empty(hits, np.int64)
    n, found = 0, 0
    for pair in order:
        a, b = i[pair], j[pair]
        middle_x, middle_y = (objects[a, 0] + objects[b, 0]) / 2, (objects[a, 1] + objects[b, 1]) / 2
        middle_z, rise = (objects[a, 2] + objects[b, 2]) / 2, objects[b, 2] - objects[a, 2]
        for hit in range(low[pair], low[pair] + number[pair]):
            building = table.building[hit]
            if not can[building] or abs(table.rise[hit] - rise) > height_m:
                continue
            u, v = table.off[hit]
            c, s = u * off[pair, 0] + v * off[pair, 1], v * off[pair, 0] - u * off[pair, 1]
            px = table.middle[hit, 0] - (c * middle_x - s * middle_y)
            py = table.middle[hit, 1] - (s * middle_x + c * middle_y)
            pz = table.z[hit] - middle_z
            heading = int(np.rint(table.steps[hit] - steps[pair])) % headings
            cell = building << bits
            cell = (cell + _within((px - table.corner[building, 0]) / cell_m, bits, middle)) << bits
            cell = (cell + _within((py - table.corner[building, 1]) / cell_m, bits, middle)) << 5
            layer = int(min(max(math.floor(pz / layer_m + 0.37), -15.0), 14.0)) + 16
            cell = ((cell + layer) << 5) + heading
            slot = _slot(keys, cell)
            if keys[slot] < 0:
                keys[slot] = cell
                cells[found] = slot
                found += 1
            votes[slot] += worth[pair]
            x[n], y[n], z[n], slot_of[n], weight[n], of[n] = px, py, pz, slot, worth[pair], building
            n += 1
    slots = _most(cells[:found], keys, votes, most)
    total = np.empty(len(slots), np.int64)
    for k in range(len(slots)):
        cell, many = keys[slots[k]], 0
        heading = cell & 31
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                plane = (cell & ~31) + (dx << (bits + 10)) + (dy << 10)
                for dh in range(-1, 2):
                    beside = _slot(keys, plane + (heading + dh) % headings)
                    if keys[beside] >= 0:
                        many += votes[beside]
        total[k] = many
    best = slots[np.argsort(-total, kind="mergesort")[:kept]]
    which = np.full(size, -1, np.int64)
    for k in range(len(best)):
        which[best[k]] = k
    at = np.zeros((len(best), 3))
    building_of = np.zeros(len(best), np.int64)
    for k in range(n):
        to = which[slot_of[k]]
        if to >= 0:
            at[to, 0] += weight[k] * x[k]
            at[to, 1] += weight[k] * y[k]
            at[to, 2] += weight[k] * z[k]
            building_of[to] = of[k]
    rows = np.full(len(best), -1, np.int64)
    for k in range(len(best)):
        many = votes[best[k]]
        px, py, pz = at[k, 0] / many, at[k, 1] / many, at[k, 2] / many
        nearest = near_m * near_m
        for place in range(table.place_start[building_of[k]], table.place_start[building_of[k] + 1]):
            ax, ay, az = px - table.place_x[place], py - table.place_y[place], pz - table.place_z[place]
            square = ax * ax + ay * ay + az * az
            if square < nearest or (square == nearest and rows[k] < 0):
                nearest, rows[k] = square, place
    return rows


@kernel
def _within(cells: float, bits: int, middle: int) -> int:
    return int(min(max(math.floor(cells + 0.37), float(1 - middle)), float(2**bits - middle - 2))) + middle


@kernel
def _slot(keys: Ints, cell: int) -> int:
    """Where a cell is kept in a table of 2^k, or would be."""
    mask = len(keys) - 1
    # Fibonacci hashing: all of the cell tells in the bits that are taken.
    slot = ((cell * 0x61C8864680B583EB) >> 40) & mask
    while keys[slot] >= 0 and keys[slot] != cell:
        slot = (slot + 1) & mask
    return slot


@kernel
def _most(slots: Ints, keys: Ints, votes: Ints, most: int) -> Ints:
    """Those with the most votes, of as many the lower cell first."""
    if len(slots) > most:
        many = votes[slots]
        least = np.partition(many, len(many) - most)[len(many) - most]
        slots = slots[many >= least]
    slots = slots[np.argsort(keys[slots], kind="mergesort")]
    return slots[np.argsort(-votes[slots], kind="mergesort")[:most]]
