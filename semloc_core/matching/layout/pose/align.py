"""Poses made to fit, and scored: expectation–maximisation over a turn and a shift, many poses at once.

The seen objects are taken as a Poisson process in the plane: where the map has an object of the class, seen with
probability ``detected`` and displaced by a Gaussian; everywhere else invented, at a rate a square metre. Against all
invented, the log-likelihood ratio of what is seen is

    Σ_i log(1 + Σ_j detected(j) · N(T x_i; y_j, spread) / invented_class(i))    what the map explains
    − looked · Σ_j detected(j) [T⁻¹ y_j near a known place]                           what should have been seen too
    − Σ_k cost of the room at T p_k                                          where the map has no room

(times `MappedLayout.weights` where a seen object may be of several classes)

with x seen objects, y mapped ones of the same class, p known places and T the pose (turn about gravity, shift).

How exact a detector is nobody says, so several spreads are tried, the widest first, and each pose keeps the one that
explains most. Of narrower ones more would fit by chance: what a spread gains by choosing among more poses is taken from
it, the logarithm of how much narrower it is for each of a pose's `FREE` numbers (Laplace's approximation of the
evidence). The objects bear it by their shares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.expected_objects import expected, looked_at
from semloc_core.matching.layout.pose.local_map import Complex, around_rows, seen_table
from semloc_core.matching.layout.pose.pairs import FAR, Pairs, fit, pairs_at
from semloc_core.text import short_repr

ROUNDS = 4
"""Rounds of expectation–maximisation at the widest spread; they settle in two or three."""
NARROWER = (0.5, 0.25, 0.125)
"""Further spreads, as shares of the map's."""
MORE_ROUNDS = 2
"""Rounds of expectation–maximisation at each of these."""
FARTHER = 0.2
"""Share of the objects that are off by the widest spread, whatever the others are."""
FREE = 3
"""Numbers that a pose in the plane has."""
SOME = 4
"""Poses are judged by one in so many known places before they are aligned."""


@short_repr
@dataclass(frozen=True, eq=False)
class Aligned:
    """T poses, fitted.

    Args:
        heading: (T,) radians: the robot's frame turned by it is parallel to the map's.
        shift: (T, 2) metres from the map's place to the robot.
        rise: (T,) the same in height.
        explained: (T, n) log-likelihood ratio of each seen object, ≥ 0.
        missing: (T,) log-likelihood lost for mapped objects that should have been seen, ≥ 0.
        walls: (T,) the same for known places where the map has no room, ≥ 0.

    """

    heading: Floats
    shift: Floats
    rise: Floats
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
    if compiled():
        return _compiled(mapped, fragment, rows, heading)
    config, t, n = mapped.config, len(rows), len(fragment.classes)
    there = around_rows(mapped, rows)
    turn, shift = np.exp(1j * heading), np.zeros(t, dtype=np.complex128)
    pairs = pairs_at(mapped, fragment, there, turn, shift, FAR * (config.off_m + config.spread_m))
    anchor = (config.spread_m / config.off_m) ** 2
    for _ in range(ROUNDS):
        odds = pairs.odds(turn, shift, config.spread_m)
        total = pairs.by_seen(odds) + 1.0
        turn, shift = fit(pairs, odds / total[pairs.at], anchor)
    turn, shift, share, explained = _exact(pairs, turn, shift, config.spread_m, anchor, (t, n))
    return Aligned(
        np.angle(turn),
        np.stack([shift.real, shift.imag], axis=1),
        # Places float: by how much the robot's is higher than the map's, the objects that both have say.
        (share * pairs.above).sum(axis=1) / (share.sum(axis=1) + 1.0),
        explained,
        config.looked * expected(mapped, fragment, there, turn, shift),
        _walls(mapped, fragment, rows, turn, shift),
    )


def against(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats) -> tuple[Floats, Floats]:
    """(T,) log-likelihood lost by what is missing and by what is in walls, at (T,) rows with (T,) headings, radians."""
    turn, shift = np.exp(1j * heading), np.zeros(len(rows), dtype=np.complex128)
    # Places beside one another tell much the same.
    some = replace(fragment, places=fragment.places[::SOME])
    walls = SOME * _walls(mapped, some, rows, turn, shift)
    if not compiled():
        return mapped.config.looked * expected(mapped, fragment, around_rows(mapped, rows), turn, shift), walls
    pose = np.zeros((len(rows), 4))
    pose[:, 0], pose[:, 1] = turn.real, turn.imag
    return _missing(mapped, fragment, rows, pose), walls


def _missing(mapped: MappedLayout, fragment: Fragment, rows: Ints, pose: Floats) -> Floats:
    """(T,) log-likelihood lost by what is missing, compiled, at poses as of `compiled.against.expected`."""
    from semloc_core.matching.layout.compiled.against import expected

    return mapped.config.looked * expected(mapped.table, looked_at(mapped, fragment), rows, pose)


def _compiled(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats) -> Aligned:
    """As of `align`."""
    from semloc_core.matching.layout.compiled import poses

    config = mapped.config
    numbers = config.spread_m, config.off_m, config.height_spread_m, FAR, FARTHER
    counts = ROUNDS, MORE_ROUNDS, FREE
    seen = seen_table(mapped, fragment)
    pose, rise, explained = poses.align(mapped.table, seen, rows, heading, numbers, NARROWER, counts)
    turn, shift = np.ascontiguousarray(pose).view(np.complex128).T
    return Aligned(
        np.angle(turn),
        pose[:, 2:],
        rise,
        explained,
        _missing(mapped, fragment, rows, pose),
        _walls(mapped, fragment, rows, turn, shift),
    )


def _exact(
    pairs: Pairs, turn: Complex, shift: Complex, widest_m: float, anchor: float, shape: tuple[int, int]
) -> tuple[Complex, Complex, Floats, Floats]:
    """Poses fitted as exactly as it pays, from some that are fitted at the widest spread.

    Returns:
        (T,) turns, (T,) shifts, (T, K) probability of each pair and (T, n) log-likelihood ratio of each seen object.

    """
    wide = pairs.odds(turn, shift, widest_m)
    odds = pairs.by_seen(wide)
    best = turn, shift, wide / (odds + 1.0)[pairs.at], np.log1p(odds[:-1].reshape(shape))
    value = best[3].sum(axis=1)
    for narrower in NARROWER:
        near, far, odds = _mixed(pairs, turn, shift, widest_m, narrower)
        for _ in range(MORE_ROUNDS):
            weight = (near + narrower**2 * far) / (odds + 1.0)[pairs.at]
            turn, shift = fit(pairs, weight, narrower**2 * anchor)
            near, far, odds = _mixed(pairs, turn, shift, widest_m, narrower)
        explained = np.log1p(odds[:-1].reshape(shape))
        gained = explained.sum(axis=1)
        net = gained + FREE * math.log(narrower)
        better = np.flatnonzero(net > value)
        value[better] = net[better]
        explained *= np.divide(net, gained, out=np.zeros_like(net), where=gained > 0)[:, None]
        share = (near + far) / (odds + 1.0)[pairs.at]
        for kept, new in zip(best, (turn, shift, share, explained), strict=True):
            kept[better] = new[better]
    return best


def _mixed(
    pairs: Pairs, turn: Complex, shift: Complex, widest_m: float, narrower: float
) -> tuple[Floats, Floats, Floats]:
    """(T, K) odds of pairs by a narrower spread and by the widest, each by its share, and their sums by seen object."""
    exponent = pairs.squares(turn, shift, -1.0 / widest_m**2)
    near = (1.0 - FARTHER) / narrower**2 * (np.exp(exponent / narrower**2) * pairs.peak)
    far = FARTHER * (np.exp(exponent) * pairs.peak)
    return near, far, pairs.by_seen(near + far)


def _walls(mapped: MappedLayout, fragment: Fragment, rows: Ints, turn: Complex, shift: Complex) -> Floats:
    """(T,) log-likelihood lost for known places where the map has no room."""
    origin = mapped.positions[rows]
    origin[:, 0] += shift.real
    origin[:, 1] += shift.imag
    return mapped.rooms.lost(mapped.building[rows], turn, origin, fragment.places)
