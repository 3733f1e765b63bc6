"""Poses made to fit, and scored: expectation–maximisation over a turn and a shift, many poses at once.

The seen objects are taken as a Poisson process in the plane: where the map has an object of the class, seen with
probability ``detected`` and displaced by a Gaussian; everywhere else invented, at a rate a square metre. Against all
invented, the log-likelihood ratio of what is seen is

    Σ_i log(1 + Σ_j detected(j) · N(T x_i; y_j, spread) / invented_class(i))    what the map explains
    − looked · Σ_j detected(j) [T⁻¹ y_j near a known place]                           what should have been seen too
    − Σ_k cost of the room at T p_k                                          where the map has no room

with x seen objects, y mapped ones of the same class, p known places and T the pose (turn about gravity, shift).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.geodesic import ranges
from semloc_core.graph_arrays import Floats, Ints
from semloc_core.layout.fragment import Fragment
from semloc_core.layout.mapped import MappedLayout
from semloc_core.layout.vote import same_class

ROUNDS = 4
"""Rounds of expectation–maximisation; they settle in two or three."""
_SEEN_CELL = np.array([0.5, 0.5, 1.0])  # metres
FAR = 3.0
"""Pairs that are further apart to begin with than so many standard deviations are none."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """T poses, fitted.

    Args:
        heading: (T,) radians: the robot's frame turned by it is parallel to the map's.
        shift: (T, 2) metres from the map's place to the robot.
        explained: (T, n) log-likelihood ratio of each seen object, ≥ 0.
        missing: (T,) log-likelihood lost for mapped objects that should have been seen, ≥ 0.
        walls: (T,) the same for known places where the map has no room, ≥ 0.

    """

    heading: Floats
    shift: Floats
    explained: Floats
    missing: Floats
    walls: Floats

    @property
    def score(self) -> Floats:
        """(T,) log-likelihood ratio."""
        total: Floats = self.explained.sum(axis=1) - self.missing - self.walls
        return total


def align(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats) -> Aligned:
    """Fit and score the surroundings of the robot at T poses.

    Args:
        mapped: the map.
        fragment: what is around the robot, n objects and k places.
        rows: (T,) rows of the map to begin at.
        heading: (T,) radians to begin with.

    """
    config, t, n = mapped.config, len(rows), len(fragment.classes)
    invented = mapped.invented[fragment.classes]
    pairs = _pairs(mapped, fragment, rows, heading)
    shift, at = np.zeros((t, 2)), pairs.which * n + pairs.seen
    anchor = (config.spread_m / config.off_m) ** 2
    for _ in range(ROUNDS):
        density = pairs.densities(heading, shift, config.spread_m)
        total = _sums(at, density, t * n) + np.tile(invented, t)
        heading, shift = _fit(pairs, density / total[at], t, anchor)
    density = _sums(at, pairs.densities(heading, shift, config.spread_m), t * n).reshape(t, n)
    missing = config.looked * _expected(mapped, fragment, rows, heading, shift)
    return Aligned(
        heading, shift, np.log1p(density / invented), missing, _walls(mapped, fragment, rows, heading, shift)
    )


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of a seen and a mapped object of one class that a pose near its beginning could bring together.

    Args:
        which: (K,) the pose.
        seen: (K,) the seen object.
        here: (K, 2) where it is from the robot, metres.
        there: (K, 2) where the mapped one is from the map's place, metres.
        height: (K,) density of a match but for what the plane says of it.

    """

    which: Ints
    seen: Ints
    here: Floats
    there: Floats
    height: Floats

    def densities(self, heading: Floats, shift: Floats, spread_m: float) -> Floats:
        """(K,) density of the mapped object at the seen one."""
        c, s = np.cos(heading)[self.which], np.sin(heading)[self.which]
        x, y = self.here.T
        u = c * x - s * y + shift[self.which, 0] - self.there[:, 0]
        v = s * x + c * y + shift[self.which, 1] - self.there[:, 1]
        found: Floats = self.height * np.exp((u * u + v * v) * (-0.5 / spread_m**2))
        return found


def _pairs(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats) -> _Pairs:
    config = mapped.config
    which, seen, objects = same_class(mapped, fragment.classes, rows)
    up = fragment.objects[seen, 2] - mapped.object_positions[objects, 2] + mapped.positions[rows[which], 2]
    close = np.abs(up) <= FAR * config.height_spread_m
    which, seen, objects, up = which[close], seen[close], objects[close], up[close]
    here, there = fragment.objects[seen, :2], mapped.object_positions[objects, :2] - mapped.positions[rows[which], :2]
    height = (
        np.exp(-0.5 * (up / config.height_spread_m) ** 2) * mapped.detected[objects] / (2 * np.pi * config.spread_m**2)
    )
    c, s = np.cos(heading)[which], np.sin(heading)[which]
    x = c * here[:, 0] - s * here[:, 1] - there[:, 0]
    y = s * here[:, 0] + c * here[:, 1] - there[:, 1]
    near = x * x + y * y <= (FAR * (config.off_m + config.spread_m)) ** 2
    return _Pairs(which[near], seen[near], here[near], there[near], height[near])


def _fit(pairs: _Pairs, share: Floats, t: int, anchor: float) -> tuple[Floats, Floats]:
    """Turn and shift that bring seen objects to their shares of mapped ones, in least squares (Umeyama 1991, 2D).

    Args:
        pairs: K pairs.
        share: (K,) weights.
        t: number of poses.
        anchor: weight of the shift being none.

    """

    def sums(values: Floats) -> Floats:
        return _sums(pairs.which, share * values, t)

    total = _sums(pairs.which, share, t) + anchor
    (x, y), (u, v) = pairs.here.T, pairs.there.T
    mean_x, mean_y, mean_u, mean_v = (sums(values) / total for values in (x, y, u, v))
    # Σ w (x − x̄)(u − ū)ᵀ, the anchor (x = u = 0) among them.
    across = sums(x * v) - sums(y * u) - total * (mean_x * mean_v - mean_y * mean_u)
    along = sums(x * u) + sums(y * v) - total * (mean_x * mean_u + mean_y * mean_v)
    heading = np.arctan2(across, along)
    c, s = np.cos(heading), np.sin(heading)
    return heading, np.stack([mean_u - c * mean_x + s * mean_y, mean_v - s * mean_x - c * mean_y], axis=1)


def _sums(index: Ints, values: Floats, n: int) -> Floats:
    """(n,) sums of (K,) values by index."""
    return np.bincount(index, values, n).astype(np.float64)


def _walls(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats, shift: Floats) -> Floats:
    """(T,) log-likelihood lost for known places where the map has no room."""
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, y, z = fragment.places.T
    origin = mapped.positions[rows]
    at = np.empty((len(rows), len(fragment.places), 3))
    at[..., 0] = c * x - s * y + (shift[:, 0] + origin[:, 0])[:, None]
    at[..., 1] = s * x + c * y + (shift[:, 1] + origin[:, 1])[:, None]
    at[..., 2] = z + origin[:, 2, None]
    walls = np.zeros(len(rows))
    for building in np.unique(mapped.building[rows]).tolist():
        room, mine = mapped.rooms[building], mapped.building[rows] == building
        if room is not None:
            walls[mine] = room.at(at[mine]).sum(axis=1)
    return walls


def _expected(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats, shift: Floats) -> Floats:
    """(T,) how many of the mapped objects that lie near known places would be detected."""
    seen, low = _seen(fragment.places, mapped.config.seen_within_m)
    start, objects = mapped.objects_near
    size = start[rows + 1] - start[rows]
    which = np.repeat(np.arange(len(rows)), size)
    taken = objects[ranges(start[rows], size)]
    x, y, z = (mapped.object_positions[taken] - mapped.positions[rows[which]]).T
    c, s = np.cos(heading)[which], np.sin(heading)[which]
    x, y = x - shift[which, 0], y - shift[which, 1]
    cells = np.floor((np.stack([c * x + s * y, c * y - s * x, z], axis=1) - low) / _SEEN_CELL).astype(np.int64)
    inside = ((cells >= 0) & (cells < np.array(seen.shape))).all(axis=1)
    i, j, k = cells[inside].T
    return _sums(which[inside], seen[i, j, k] * mapped.detected[taken[inside]], len(rows))


def _seen(places: Floats, within_m: float) -> tuple[NDArray[np.bool_], Floats]:
    """Cells near a known place on its floor, and the corner of the first one."""
    reach = int(np.ceil(within_m / _SEEN_CELL[0]))
    if not len(places):
        return np.zeros((1, 1, 1), dtype=np.bool_), np.zeros(3)
    margin = np.array([reach, reach, 1])
    low: Floats = places.min(axis=0) - margin * _SEEN_CELL
    cells = np.floor((places - low) / _SEEN_CELL).astype(np.int64)
    seen = np.zeros(cells.max(axis=0) + margin + 1, dtype=np.bool_)
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            if np.hypot(dx, dy) * _SEEN_CELL[0] <= within_m:
                for dz in (-1, 0, 1):
                    seen[cells[:, 0] + dx, cells[:, 1] + dy, cells[:, 2] + dz] = True
    return seen, low
