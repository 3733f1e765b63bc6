"""Poses made to fit, and scored: expectation–maximisation over a turn and a shift, many poses at once.

The seen objects are taken as a Poisson process in the plane: where the map has an object of the class, seen with
probability ``detected`` and displaced by a Gaussian; everywhere else invented, at a rate a square metre. Against all
invented, the log-likelihood ratio of what is seen is

    Σ_i log(1 + Σ_j detected(j) · N(T x_i; y_j, spread) / invented_class(i))    what the map explains
    − looked · Σ_j detected(j) [T⁻¹ y_j near a known place]                           what should have been seen too
    − Σ_k cost of the room at T p_k                                          where the map has no room

(times `MappedLayout.weights` where a seen object may be of several classes)

with x seen objects, y mapped ones of the same class, p known places and T the pose (turn about gravity, shift).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.building.objects_by_place import sums
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.expected_objects import expected
from semloc_core.matching.layout.pose.local_map import Complex, There, around_rows
from semloc_core.text import short_repr

ROUNDS = 4
"""Rounds of expectation–maximisation; they settle in two or three."""
FAR = 3.0
"""Pairs that are further apart to begin with than so many standard deviations are none."""


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
    config, t, n = mapped.config, len(rows), len(fragment.classes)
    there = around_rows(mapped, rows)
    turn, shift = np.exp(1j * heading), np.zeros(t, dtype=np.complex128)
    pairs = pairs_at(mapped, fragment, there, turn, shift, FAR * (config.off_m + config.spread_m))
    anchor = (config.spread_m / config.off_m) ** 2
    for _ in range(ROUNDS):
        odds = pairs.odds(turn, shift, config.spread_m)
        total = pairs.by_seen(odds) + 1.0
        turn, shift = fit(pairs, odds / total[pairs.at], anchor)
    each = pairs.odds(turn, shift, config.spread_m)
    odds = pairs.by_seen(each)
    share = each / (odds + 1.0)[pairs.at]
    odds = odds[: t * n].reshape(t, n)
    return Aligned(
        np.angle(turn),
        np.stack([shift.real, shift.imag], axis=1),
        # Places float: by how much the robot's is higher than the map's, the objects that both have say.
        (share * pairs.above).sum(axis=1) / (share.sum(axis=1) + 1.0),
        np.log1p(odds),
        config.looked * expected(mapped, fragment, there, turn, shift),
        _walls(mapped, fragment, rows, turn, shift),
    )


@short_repr
@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of a seen and a mapped object of one class that a pose near its beginning could bring together.

    For each of T poses there is room for K pairs; where it has fewer the rest have no weight.

    Args:
        terms: (T, 8, K) for a seen object at x and a mapped one at y, complex: x, y and x̄y, each its two parts, 1, and
            |x|² + |y|². The squared distance at any pose is linear in them, and so are the moments that fit a pose.
        peak: (T, K) odds of a match but for what the plane says of it, against the object being invented.
        above: (T, K) metres that the mapped one is higher over its place than the seen one.
        at: (T, K) numbers of pose and seen object in one, as if all poses' objects were counted through.
        size: how many of these numbers there are.

    """

    terms: Floats
    peak: Floats
    above: Floats
    at: Ints
    size: int

    def squares(self, turn: Complex, shift: Complex, factor: float = 2.0) -> Floats:
        """(T, K) half the squared distances of both at these poses, m², times a factor."""
        # |turn · x + shift − y|², multiplied out.
        factors = np.stack([shift * np.conj(turn), -shift, -turn, 0.5 * np.abs(shift) ** 2 + 0.5j], axis=1)
        factors *= factor
        found: Floats = (factors.view(np.float64)[:, None] @ self.terms)[:, 0]
        return found

    def odds(self, turn: Complex, shift: Complex, spread_m: float) -> Floats:
        """(T, K) odds that the seen object is the mapped one, and not invented."""
        found = self.squares(turn, shift, -1.0 / spread_m**2)
        np.exp(found, out=found)
        found *= self.peak
        return found

    def by_seen(self, values: Floats) -> Floats:
        """Sums of (T, K) values by pose and seen object."""
        return sums(self.at.ravel(), values.ravel(), self.size)


def pairs_at(
    mapped: MappedLayout, fragment: Fragment, there: There, turn: Complex, shift: Complex, reach: float
) -> Pairs:
    """The pairs of a fragment and what is around T places that (T,) turns and shifts bring within ``reach`` metres."""
    config, t, n = mapped.config, len(turn), len(fragment.classes)
    if fragment.likely is None:
        weights = None
        kind, of_class = mapped.kinds(fragment.classes)
        kinds = of_class[there.classes]
    else:  # an object may be of several classes: whether it is of a mapped one's is asked of those that are near
        weights = mapped.weights(fragment.likely)
        kind = np.zeros(n, dtype=np.int32)
        kinds = np.where((weights > 0).any(axis=0), 0, -1)[there.classes]
    wanted = np.flatnonzero(kinds >= 0)
    x, y, up = np.ascontiguousarray(fragment.objects.T)
    # One product has all squared distances. Kinds lie far apart along a third axis: pairs are of one kind.
    where = there.seen_from(turn, shift)[wanted]
    a = np.ones((5, len(wanted)))
    a[0], a[1], a[2] = where.real, where.imag, kinds[wanted] * (2 * reach)
    a[3] = (a[:3] ** 2).sum(axis=0)
    b = np.stack([x, y, kind * (2 * reach)])
    b = np.vstack([-2 * b, np.ones(n), (b**2).sum(axis=0)])
    entry, seen = np.divmod(np.flatnonzero(a.T @ b <= reach**2), n)
    entry = wanted[entry]
    above = (up[seen] - there.up[entry]) / config.height_spread_m
    weight = None if weights is None else weights[seen, there.classes[entry]]
    close = np.flatnonzero((np.abs(above) <= FAR) & (True if weight is None else weight > 0))
    entry, seen, above = entry[close], seen[close], above[close]
    which = there.which[entry]  # in rising order
    number = np.bincount(which, minlength=t)
    k = int(number.max(initial=0)) + 1
    at = np.arange(len(which)) + (np.arange(t) * k - np.cumsum(number) + number)[which]
    peak, rise, of = np.zeros(t * k), np.zeros(t * k), np.full(t * k, t * n)
    peak[at] = mapped.odds[there.objects[entry]] * np.exp(-0.5 * above * above)
    if weight is not None:
        peak[at] *= weight[close]
    rise[at] = there.up[entry] - up[seen]
    of[at] = which * n + seen
    here, offset = (x + 1j * y)[seen], there.offset[entry]
    both = np.conj(here) * offset
    squares = here.real**2 + here.imag**2 + offset.real**2 + offset.imag**2
    terms = np.zeros((8, t * k))
    for row, term in zip(
        terms, (here.real, here.imag, offset.real, offset.imag, both.real, both.imag, 1.0, squares), strict=True
    ):
        row[at] = term
    shape = (t, k)
    return Pairs(
        terms.reshape(8, t, k).transpose(1, 0, 2),
        peak.reshape(shape),
        rise.reshape(shape),
        of.reshape(shape),
        t * n + 1,
    )


def fit(pairs: Pairs, share: Floats, anchor: float) -> tuple[Complex, Complex]:
    """Turn and shift that bring seen objects to their shares of mapped ones, in least squares (Umeyama 1991, 2D).

    Args:
        pairs: of T poses.
        share: (T, K) weights.
        anchor: weight of the shift being none.

    """
    moments = (pairs.terms[:, :7] @ share[:, :, None])[:, :, 0]
    x, y, both = np.ascontiguousarray(moments[:, :6]).view(np.complex128).T
    total = moments[:, 6] + anchor
    x, y = x / total, y / total
    # Σ w (x − x̄)(y − ȳ), x conjugated, the anchor (x = y = 0) among them.
    turn = both - total * np.conj(x) * y
    size = np.abs(turn)
    turn = np.divide(turn, size, out=np.ones(len(turn), dtype=np.complex128), where=size > 0)
    return turn, y - turn * x


def _walls(mapped: MappedLayout, fragment: Fragment, rows: Ints, turn: Complex, shift: Complex) -> Floats:
    """(T,) log-likelihood lost for known places where the map has no room."""
    origin = mapped.positions[rows]
    origin[:, 0] += shift.real
    origin[:, 1] += shift.imag
    return mapped.rooms.lost(mapped.building[rows], turn, origin, fragment.places)
