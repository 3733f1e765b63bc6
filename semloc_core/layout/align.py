"""Poses made to fit, and scored: expectation–maximisation over a turn and a shift, many poses at once.

The seen objects are taken as a Poisson process in the plane: where the map has an object of the class, seen with
probability ``detected`` and displaced by a Gaussian; everywhere else invented, at a rate a square metre. Against all
invented, the log-likelihood ratio of what is seen is

    Σ_i log(1 + detected · Σ_j N(T x_i; y_j, spread) / invented_class(i))    what the map explains
    − detected · looked · |{j : T⁻¹ y_j near a known place}|                          what should have been seen too
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

ROUNDS = 4
"""Rounds of expectation–maximisation; they settle in two or three."""
_SEEN_CELL = np.array([0.5, 0.5, 1.0])  # metres
_PAD = 1e6  # metres: where objects lie that only fill up a row


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
    config = mapped.config
    there, classes = _mapped_around(mapped, rows)
    invented = mapped.invented[fragment.classes]
    same = (fragment.classes[:, None] == classes[:, None, :]) * (config.detected / (2 * np.pi * config.spread_m**2))
    up = fragment.objects[:, 2, None] - there[:, None, :, 2]
    same = same * np.exp(-0.5 * (up / config.height_spread_m) ** 2)  # (T, n, m)
    shift = np.zeros((len(rows), 2))
    turned = _turned(fragment.objects[:, :2], heading)
    for _ in range(ROUNDS):
        share = _densities(turned + shift[:, None], there, same, config.spread_m)
        share /= (share.sum(axis=2) + invented)[:, :, None]
        heading, shift = _fit(fragment.objects[:, :2], there[..., :2], share, (config.spread_m / config.off_m) ** 2)
        turned = _turned(fragment.objects[:, :2], heading)
    density = _densities(turned + shift[:, None], there, same, config.spread_m).sum(axis=2)
    missing = config.detected * config.looked * _expected(mapped, fragment, there, classes, heading, shift)
    places = np.empty((len(rows), len(fragment.places), 3))
    places[..., :2] = _turned(fragment.places[:, :2], heading) + shift[:, None]
    places[..., 2] = fragment.places[:, 2]
    places += mapped.positions[rows][:, None]
    walls = np.zeros(len(rows))
    for building in np.unique(mapped.building[rows]).tolist():
        room, mine = mapped.room(building), mapped.building[rows] == building
        if room is not None:
            walls[mine] = room.at(places[mine]).sum(axis=1)
    return Aligned(heading, shift, np.log1p(density / invented), missing, walls)


def _mapped_around(mapped: MappedLayout, rows: Ints) -> tuple[Floats, Ints]:
    """(T, m, 3) mapped objects around each place, relative to it, and (T, m) their classes; filled up with class -1."""
    start, objects = mapped.objects_near
    size = start[rows + 1] - start[rows]
    there = np.full((len(rows), int(size.max(initial=0)), 3), _PAD)
    classes = np.full(there.shape[:2], -1, dtype=np.int64)
    taken = np.arange(there.shape[1]) < size[:, None]
    found = objects[ranges(start[rows], size)]
    there[taken] = mapped.object_positions[found] - np.repeat(mapped.positions[rows], size, axis=0)
    classes[taken] = mapped.object_classes[found]
    return there, classes


def _turned(points: Floats, heading: Floats) -> Floats:
    """(T, n, 2) points (n, 2) turned by each heading."""
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, y = points.T
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _densities(at: Floats, there: Floats, same: Floats, spread_m: float) -> Floats:
    """(T, n, m) density of each mapped object at each seen one, by their pose in the plane; ``same`` holds the rest."""
    x = at[:, :, None, 0] - there[:, None, :, 0]
    y = at[:, :, None, 1] - there[:, None, :, 1]
    found: Floats = same * np.exp((x * x + y * y) * (-0.5 / spread_m**2))
    return found


def _fit(points: Floats, there: Floats, share: Floats, anchor: float) -> tuple[Floats, Floats]:
    """Turn and shift that bring points to their shares of mapped objects, in least squares (Umeyama 1991, 2D).

    Args:
        points: (n, 2).
        there: (T, m, 2).
        share: (T, n, m) weights.
        anchor: weight of the shift being none.

    """
    weight = share.sum(axis=2)
    goal = share @ np.where(there < _PAD / 2, there, 0.0)  # (T, n, 2), each times its weight
    total = weight.sum(axis=1) + anchor
    mean_here = (weight @ points) / total[:, None]
    mean_there = goal.sum(axis=1) / total[:, None]
    # Σ w (x − x̄)(y − ȳ)ᵀ, the anchor (x = y = 0) among them.
    cross = np.einsum("ni,tnj->tij", points, goal) - total[:, None, None] * mean_here[:, :, None] * mean_there[:, None]
    heading = np.arctan2(cross[:, 0, 1] - cross[:, 1, 0], cross[:, 0, 0] + cross[:, 1, 1])
    c, s = np.cos(heading), np.sin(heading)
    x, y = mean_here.T
    return heading.astype(np.float64), mean_there - np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _expected(
    mapped: MappedLayout, fragment: Fragment, there: Floats, classes: Ints, heading: Floats, shift: Floats
) -> Floats:
    """(T,) how many of the mapped objects lie where the robot has looked."""
    seen, low = _seen(fragment.places, mapped.config.seen_within_m)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, y = there[..., 0] - shift[:, None, 0], there[..., 1] - shift[:, None, 1]
    back = np.stack([c * x + s * y, c * y - s * x, there[..., 2]], axis=-1)
    cells = np.floor((back - low) / _SEEN_CELL).astype(np.int64)
    inside = ((cells >= 0) & (cells < np.array(seen.shape))).all(axis=-1) & (classes >= 0)
    i, j, k = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
    found: Floats = (inside & seen[i, j, k]).sum(axis=1).astype(np.float64)
    return found


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
