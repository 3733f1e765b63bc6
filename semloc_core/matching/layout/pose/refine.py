"""Poses that were tested, made exact to centimetres and degrees, and how exact they are.

The test's alignment is wide, so that it finds its way, and pulls towards the map's place. From there on the objects
alone decide: a seen object lies where the map has it but for a Student-t error in the plane (most are small, some are
large: a detector's, or things that were moved), or is invented. Expectation–maximisation begins with a wide spread,
which narrows to what the residuals say (graduated non-convexity), under a prior.

What was seen long ago was written in a frame that has drifted since, as a random walk in the way walked: the oldest
objects are taken in first, and what they say is spread before newer ones are (a Kalman filter in information form, over
the objects' ages). How much the frame drifts is known where objects that are seen again are written anew (`Ages`);
else some drifts are tried, and weighted by how well they explain the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import SHIFT_M, TURN_RAD, Floats, Ints
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.local_map import Complex, around_rows, seen_table
from semloc_core.matching.layout.pose.pairs import FAR, Pairs, best_pose, pairs_at
from semloc_core.text import short_repr

REACH_M = 1.5
"""Pairs that are further apart at the pose to begin with are none."""
SPREADS_M = (0.25, 0.1, 0.0)
"""The least spread in each round of expectation–maximisation."""
USUAL_M = 0.12
"""Standard deviation of an object, per axis, before its fellows' residuals are known."""
USUAL_WEIGHT = 1.5
"""So many objects' residuals that is worth."""
LEAST_M, MOST_M = 0.01, 0.5
"""Bounds of the spread."""
FREEDOM = 4
"""Degrees of freedom of the errors' Student-t distribution; even."""
DOUBT_WEIGHT = 2.0
"""So many objects' residuals speak for information being what it would be of Student-t errors."""
DRIFTS = (0.0, 1.0)
"""Drifts that are tried where it is not known, as variances: 1 is that of `TURN_RAD` and `SHIFT_M`."""
CAUTION = 2.0
"""Known drifts are taken for so much more: the robot turns about where it was then, not about where it is."""
AGES_M = (1.0, 4.0, 12.0)
"""Where objects are parted by their ages, metres walked."""
WIDE = np.diag([1.0, 1.0, 1.0])
"""Covariance of what is known before any object is looked at, x, y (m) and yaw."""
HEIGHT_M = 0.5
"""Standard deviation of the robot's place over the map's: both are of one storey."""
PLANE = np.array([0, 1, 3])
"""Of x, y, z and the heading those that a turn and a shift in the plane have."""
INFORMATION = np.array([[0, 0, 1], [0, 0, 2], [1, 2, 3]])
UNCOUPLED = np.array([0, 1]), np.array([1, 0])
"""Which of the sums that `_settled` makes are where in the information, and where it has none."""
FLOOR = np.array([0.004, 0.004, 0.004, np.radians(0.06)]) ** 2
"""Variances that nothing is known better than."""


@short_repr
@dataclass(frozen=True, eq=False)
class Refined:
    """T poses of a fragment's place in the map.

    Args:
        heading: (T,) radians: the robot's frame turned by it is parallel to the map's.
        shift: (T, 3) metres from the map's place to the robot's.
        score: (T,) log-likelihood ratio of the seen objects under the narrow spread, ≥ 0.
        covariance: (T, 4, 4) of x, y, z (m) and the heading (rad).

    """

    heading: Floats
    shift: Floats
    score: Floats
    covariance: Floats


def refine(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats, shift: Floats) -> Refined:
    """Refine T aligned poses.

    Args:
        mapped: the map.
        fragment: what is around the robot, n objects.
        rows: (T,) rows of the map.
        heading: (T,) radians, as aligned.
        shift: (T, 2) metres, as aligned.

    """
    if compiled():
        return _compiled(mapped, fragment, rows, heading, shift)
    turn, at = np.exp(1j * heading), shift @ np.array([1.0, 1j])
    pairs = pairs_at(mapped, fragment, around_rows(mapped, rows), turn, at, REACH_M)
    # Each pose once for each drift that is tried.
    tried = _drifts(fragment)[:, None, None]
    near = Near.of(pairs, fragment, len(tried), mapped.config.spread_m)
    turn, at = (np.tile(values, (len(tried), 1)) for values in (turn, at))
    unrest = tried * (SHIFT_M**2 + TURN_RAD**2 * _lengths(near.seen))
    drifted = near.age * unrest
    variance = np.full((*turn.shape, 1), SPREADS_M[0] ** 2)
    known, squares = USUAL_WEIGHT * 2 * USUAL_M**2, near.squares(turn, at)
    for least in SPREADS_M:
        spread = variance + drifted
        share, close, _ = near.shares(squares, spread)
        weight = share * close / spread
        turn, at = near.fit(weight)
        squares = near.squares(turn, at)
        # A Student-t's own estimate of its spread but for drift, three of the residuals' directions spent on the pose.
        total = (variance * (1 + 2 / FREEDOM) * weight * squares + 2 * share * drifted) * (variance / spread)
        found = (total.sum(axis=2) + known) / np.maximum(2 * (share.sum(axis=2) + USUAL_WEIGHT) - 3.0, 1.0)
        variance = np.minimum(np.maximum(found, max(least, LEAST_M) ** 2), MOST_M**2)[..., None]
    spread = variance + drifted
    share, close, gained = near.shares(squares, spread)
    # Information as the residuals have it, not as a Student-t would (a sandwich estimate, but for one number a pose).
    weight = share * close
    told = weight * variance / spread
    seen = (told * told * squares).sum(axis=2) / variance[..., 0]
    doubt = (seen + DOUBT_WEIGHT) / np.maximum(told.sum(axis=2) + DOUBT_WEIGHT - 1.0, 1.0)
    moved, covariance = _settled(near, weight / doubt[..., None], variance, unrest, tried, turn, at)
    turn, at = turn * np.exp(1j * moved[..., 2]), at + moved[..., 0] + 1j * moved[..., 1]
    up, above = _height(pairs.above, share, variance)
    # The prior of the spread speaks for a drift too.
    fits = gained - USUAL_WEIGHT * (np.log(variance) + USUAL_M**2 / variance)[..., 0]
    return _together(fits, gained, turn, at, up, covariance, above)


def _drifts(fragment: Fragment) -> Floats:
    return np.array(DRIFTS if fragment.drift is None else (CAUTION * fragment.drift,))


def _compiled(mapped: MappedLayout, fragment: Fragment, rows: Ints, heading: Floats, shift: Floats) -> Refined:
    """As of `refine`."""
    from semloc_core.matching.layout.compiled.refine import refine as work

    config = mapped.config
    fits, gained, pose, covariance, above = work(
        mapped.table,
        seen_table(mapped, fragment),
        rows,
        np.ascontiguousarray(heading),
        np.ascontiguousarray(shift),
        _drifts(fragment),
        SPREADS_M,
        AGES_M,
        (REACH_M, FAR, config.spread_m, config.height_spread_m),
        (SHIFT_M, TURN_RAD, LEAST_M, MOST_M, USUAL_M, USUAL_WEIGHT, float(FREEDOM), DOUBT_WEIGHT, HEIGHT_M),
    )
    turn, at = pose[..., :4].copy().view(np.complex128).transpose(2, 0, 1)
    return _together(fits, gained, turn, at, pose[..., 4], covariance, above)


@short_repr
@dataclass(frozen=True, eq=False)
class Near:
    """The pairs that T poses bring together, each looked at by D drifts. Points of the plane are complex numbers.

    There is room for K pairs; where a pose has fewer the rest have no weight.

    Args:
        seen: (T, K) the seen objects, metres.
        there: (T, K) the mapped ones.
        sums: (T, K, 4) what a pose is fitted by: both, the product of the first's conjugate with the second, and one.
        peak: (T, K) odds of a match at no distance but for the spread's part in them.
        age: (T, K) metres walked since the seen object changed.
        number: (D, T, K) numbers of drift, pose and seen object in one.
        counts: how many of these there are a drift, the last of them for what is no pair.

    """

    seen: Complex
    there: Complex
    sums: Complex
    peak: Floats
    age: Floats
    number: Ints
    counts: int

    @classmethod
    def of(cls, pairs: Pairs, fragment: Fragment, drifts: int, spread_m: float) -> Near:
        """Of pairs whose odds are of a spread, metres."""
        n, none = len(fragment.classes), pairs.size - 1
        sums = np.ones((*pairs.at.shape, 4), dtype=np.complex128)
        for i, parts in enumerate((sums.real, sums.imag)):
            parts[..., :3] = pairs.terms[:, i:6:2].transpose(0, 2, 1)
        age = np.append(fragment.ages, 0.0)[np.where(pairs.at < none, pairs.at % n, n)]
        number = pairs.at + pairs.size * np.arange(drifts)[:, None, None]
        seen, there = sums[..., 0].copy(), sums[..., 1].copy()
        return cls(seen, there, sums, pairs.peak * spread_m**2, age, number, pairs.size)

    def squares(self, turn: Complex, at: Complex) -> Floats:
        """(D, T, K) squared distances of both at (D, T) poses, m²."""
        return _lengths(self.off(turn, at))

    def off(self, turn: Complex, at: Complex) -> Complex:
        """(D, T, K) by how much the seen object is off the mapped one, metres."""
        found = turn[..., None] * self.seen
        found += at[..., None]
        found -= self.there
        return found

    def shares(self, squares: Floats, variance: Floats) -> tuple[Floats, Floats, Floats]:
        """(D, T, K) probability of each pair and closeness of its two, in (0, 1]; (D, T) log-likelihood ratio."""
        close = 1.0 / (1.0 + squares / (FREEDOM * variance))
        odds = close * close * close * self.peak / variance
        total = np.bincount(self.number.ravel(), odds.ravel(), len(odds) * self.counts) + 1.0
        gained = np.log(total.reshape(len(odds), -1)[:, :-1].reshape(*odds.shape[:2], -1)).sum(axis=2)
        return odds / total[self.number], close, gained

    def fit(self, weight: Floats) -> tuple[Complex, Complex]:
        """(D, T) turns and shifts that bring seen to mapped objects in least squares, by (D, T, K) weights."""
        x, y, both, total = np.moveaxis((weight[:, :, None] @ self.sums)[:, :, 0], -1, 0)
        return best_pose(x, y, both, total.real + 1e-9)


def _lengths(points: Complex) -> Floats:
    """Squared."""
    found: Floats = points.real**2 + points.imag**2
    return found


def _together(
    fits: Floats, gained: Floats, turn: Complex, at: Complex, up: Floats, covariance: Floats, above: Floats
) -> Refined:
    """Each pose as the drifts have it together, weighted by how well they explain what is seen, (D, T)."""
    each = np.arange(fits.shape[1])
    likely = np.exp(fits - fits.max(axis=0))
    likely /= likely.sum(axis=0)
    best = fits.argmax(axis=0)
    heading = turn[best, each]
    off = np.empty((*fits.shape, 3))
    off[..., 0], off[..., 1], off[..., 2] = at.real, at.imag, np.angle(turn * np.conj(heading))
    mean = (likely[..., None] * off).sum(axis=0)
    off -= mean
    spread = covariance + off[..., :, None] * off[..., None, :]
    whole = np.zeros((len(each), 4, 4))
    whole[:, PLANE[:, None], PLANE] = (likely[..., None, None] * spread).sum(axis=0)
    whole[:, 2, 2] = above[best, each]
    whole[:, np.arange(4), np.arange(4)] += FLOOR
    shift = np.empty((len(each), 3))
    shift[:, :2], shift[:, 2] = mean[:, :2], up[best, each]
    return Refined(np.angle(heading) + mean[:, 2], shift, gained[best, each], whole)


def _settled(
    near: Near, weight: Floats, variance: Floats, unrest: Floats, tried: Floats, turn: Complex, at: Complex
) -> tuple[Floats, Floats]:
    """(D, T, 3) what x, y and yaw are still to be moved by once drift is reckoned with; (D, T, 3, 3) covariance.

    Args:
        near: pairs of T poses.
        weight: (D, T, K) of the pairs.
        variance: (D, T, 1) of their residuals, m².
        unrest: (D, T, K) variance that a metre walked adds to where the seen object is, m².
        tried: (D, 1, 1) drift.
        turn: (D, T) of the poses.
        at: (D, T) the same.

    """
    groups = np.searchsorted(AGES_M, near.age, side="right")
    there = groups == np.arange(len(AGES_M) + 1)[:, None, None]
    there &= near.peak > 0
    youngest = np.where(there, near.age, np.inf).min(axis=(1, 2), initial=np.inf)
    some = np.flatnonzero(np.isfinite(youngest))
    z, off = turn[..., None] * near.seen, -near.off(turn, at)
    # What each pair says of the pose, in information form: J = [1, i z].
    parts = np.empty((*weight.shape, 7))
    turned = np.conj(z) * off
    for part, values in enumerate((1.0, -z.imag, z.real, _lengths(z), off.real, off.imag, turned.imag)):
        parts[..., part] = values
    # Of a group each object is taken in when the youngest is; until then it has drifted by itself.
    trust = weight / (variance + np.maximum(near.age - youngest[groups], 0.0) * unrest)
    sums = (there[some].transpose(1, 0, 2) * trust[:, :, None]) @ parts
    info, said = sums[..., INFORMATION], sums[..., 4:, None]
    info[..., *UNCOUPLED] = 0.0
    drift = tried[..., None] * np.diag([SHIFT_M**2, SHIFT_M**2, TURN_RAD**2])
    mean, known, last = np.zeros((*turn.shape, 3, 1)), WIDE, np.inf
    for group in range(len(some) - 1, -1, -1):
        its, young = info[:, :, group], float(youngest[some[group]])
        if last < np.inf:
            known = known + drift * (last - young)
        last = young
        known = np.linalg.inv(np.eye(3) + known @ its) @ known
        mean = mean + known @ (said[:, :, group] - its @ mean)
    known = known + drift * (last if last < np.inf else 0.0)
    return mean[..., 0], 0.5 * (known + known.swapaxes(2, 3))


def _height(above: Floats, share: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """(D, T) metres of the robot's place over the map's, by how much (T, K) objects are higher, and its variance."""
    up = np.zeros(share.shape[:2])
    for _ in range(3):
        off = above - up[..., None]
        weight = share / (variance + off * off / FREEDOM)
        total = weight.sum(axis=2) + 1.0 / HEIGHT_M**2
        up = (weight * above).sum(axis=2) / total
    return up, 1.0 / total
