"""Places: irregular samples of free space, and the traversability edges between them, as Hydra finds them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from semloc_core.sources.world.floor_plan import FloorPlan
from semloc_core.sources.world.furniture import Item

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WALL_MARGIN_M = 0.3
FURNITURE_MARGIN_M = 0.1
DOOR_SPACING_M = 0.8
DOOR_EDGES = 3


def sample_places(
    plan: FloorPlan,
    items: Sequence[Item],
    darts_per_m2: float,
    spacing_m: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Floats, Ints]:
    """Throw darts into free space; keep those far enough from the ones kept before, each by a distance of its own.

    Every door gets a place (a wide opening several), so that rooms can be connected through it.

    Args:
        plan: the floor.
        items: what stands on it.
        darts_per_m2: how many are thrown; few leave gaps, many leave places as near as ``spacing_m`` allows.
        spacing_m: bounds of the distance that a place keeps from those before it.
        rng: source of the darts.

    Returns:
        (P, 2) positions (m); (P,) room of each, -1 - d for a place in door d.

    """
    points: list[Floats] = []
    rooms: list[Ints] = []
    for d, door in enumerate(plan.doors):
        n = max(1, int(door.width / DOOR_SPACING_M))
        offsets = (np.arange(n) - (n - 1) / 2) * door.width / n
        at_door = np.tile(door.centre, (n, 1))
        at_door[:, door.axis] += offsets
        points.append(at_door)
        rooms.append(np.full(n, -1 - d))
    for r, room in enumerate(plan.rooms):
        low, high = np.array(room.low), np.array(room.high)
        n = int(darts_per_m2 * np.prod(high - low))
        darts = rng.uniform(low + WALL_MARGIN_M, high - WALL_MARGIN_M, size=(n, 2))
        apart = rng.uniform(*spacing_m, size=n)
        for item in (item for item in items if item.room == r):
            outside = np.abs(darts - item.position[:2]) > np.array(item.half) + FURNITURE_MARGIN_M
            clear = outside.any(axis=1)
            darts, apart = darts[clear], apart[clear]
        near_doors = [
            p for p, owner in zip(points, rooms, strict=True) if owner[0] < 0 and r in plan.doors[-1 - owner[0]].rooms
        ]
        kept = np.concatenate([*near_doors, np.empty((len(darts), 2))])
        first = end = len(kept) - len(darts)
        for dart, distance in zip(darts, apart, strict=True):
            if ((kept[:end] - dart) ** 2).sum(axis=1).min(initial=np.inf) >= distance**2:
                kept[end] = dart
                end += 1
        points.append(kept[first:end])
        rooms.append(np.full(end - first, r))
    return np.concatenate(points), np.concatenate(rooms).astype(np.int64)


def traversability(plan: FloorPlan, items: Sequence[Item], points: Floats, rooms: Ints, max_length_m: float) -> Ints:
    """Edges between places with free space between them.

    Within a room (convex) the Delaunay edges up to ``max_length_m`` that cross no furniture; a door's place is joined
    to the nearest places on either side.

    Args:
        plan: the floor.
        items: what stands on it.
        points: (P, 2) positions (m).
        rooms: (P,) as `sample_places` returns it.
        max_length_m: longest edge.

    Returns:
        (2, E) int64, each edge once, first row < second row.

    """
    from scipy.spatial import Delaunay, QhullError

    edges: set[tuple[int, int]] = set()
    for r in range(len(plan.rooms)):
        here = np.flatnonzero(rooms == r)
        in_room = [item for item in items if item.room == r]
        if len(here) >= 4:
            try:
                triangles = here[Delaunay(points[here]).simplices]
                candidates = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]])
            except QhullError:  # all places on one line
                candidates = np.stack([here[:-1], here[1:]], axis=1)
        else:
            candidates = np.array([(a, b) for a in here for b in here if a < b], dtype=np.int64).reshape(-1, 2)
        edges.update(_free(candidates, in_room, points, max_length_m))
        for d, door in enumerate(plan.doors):
            if r not in door.rooms or len(here) == 0:
                continue
            for place in np.flatnonzero(rooms == -1 - d):
                nearest = here[np.argsort(np.linalg.norm(points[here] - points[place], axis=1), kind="stable")]
                pairs = np.stack([np.full(len(nearest), place), nearest], axis=1)
                edges.update(_free(pairs, in_room, points, max_length_m)[:DOOR_EDGES])
    for d in range(len(plan.doors)):
        row = np.flatnonzero(rooms == -1 - d)
        edges.update((int(a), int(b)) for a, b in pairwise(row))
    return np.array(sorted((min(a, b), max(a, b)) for a, b in edges), dtype=np.int64).reshape(-1, 2).T


def _free(pairs: Ints, items: Sequence[Item], points: Floats, max_length_m: float) -> list[tuple[int, int]]:
    """The pairs that are short enough and cross no footprint (a segment against boxes, by slabs)."""
    start, step = points[pairs[:, 0]], points[pairs[:, 1]] - points[pairs[:, 0]]
    free = np.linalg.norm(step, axis=1) <= max_length_m
    step = np.where(np.abs(step) < 1e-9, 1e-9, step)
    for item in items:
        near, far = (np.array(item.position[:2]) + sign * np.array(item.half) for sign in (-1.0, 1.0))
        enter, leave = (near - start) / step, (far - start) / step
        first = np.minimum(enter, leave).max(axis=1)
        last = np.maximum(enter, leave).min(axis=1)
        free &= ~((first < last) & (first < 1.0) & (last > 0.0))
    return [(int(min(a, b)), int(max(a, b))) for a, b in pairs[free]]


def largest_component(n_places: int, edges: Ints) -> NDArray[np.bool_]:
    """(P,) bool: the places of the largest connected component (of equally large ones the first)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(edges.shape[1]), (edges[0], edges[1])), shape=(n_places, n_places))
    _, label = connected_components(links, directed=False)
    kept: NDArray[np.bool_] = label == np.bincount(label).argmax()
    return kept
