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
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.local_map import Complex, around_rows
from semloc_core.matching.layout.pose.pairs import Pairs, fit, pairs_at
from semloc_core.text import short_repr

REACH_M = 1.5
"""Pairs that are further apart at the pose to begin with are none."""
SPREADS_M = (0.4, 0.25, 0.0, 0.0)
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
    t, n = len(rows), len(fragment.classes)
    turn, at = np.exp(1j * heading), shift @ np.array([1.0, 1j])
    pairs = pairs_at(mapped, fragment, around_rows(mapped, rows), turn, at, REACH_M)
    age = np.append(fragment.ages, 0.0)[np.where(pairs.at < t * n, pairs.at % n, n)]
    # Each pose once for each drift: D in all, and the pose of the d-th is d % T.
    tried = DRIFTS if fragment.drift is None else (CAUTION * fragment.drift,)
    drifts = np.repeat(tried, t)[:, None]
    if len(tried) > 1:
        pairs = _repeated(pairs, t * n, len(tried))
        turn, at, age = np.tile(turn, len(tried)), np.tile(at, len(tried)), np.tile(age, (len(tried), 1))
    # The pairs' odds are those of the test's spread.
    peak = pairs.peak * mapped.config.spread_m**2
    unrest = drifts * (SHIFT_M**2 + TURN_RAD**2 * (pairs.terms[:, 0] ** 2 + pairs.terms[:, 1] ** 2))
    drifted = age * unrest
    variance = np.full((len(turn), 1), SPREADS_M[0] ** 2)
    known = USUAL_WEIGHT * 2 * USUAL_M**2
    for least in SPREADS_M:
        spread = variance + drifted
        share, near, _ = _shares(pairs, peak, turn, at, spread)
        weight = share * near / spread
        turn, at = fit(pairs, weight, 1e-9)
        # A Student-t's own estimate of its spread but for drift, three of the residuals' directions spent on the pose.
        own = variance / spread
        total = (share * own * ((1 + 2 / FREEDOM) * near * own * pairs.squares(turn, at) + 2 * drifted)).sum(axis=1)
        found = (total + known) / np.maximum(2 * (share.sum(axis=1) + USUAL_WEIGHT) - 3.0, 1.0)
        variance = np.clip(found, max(least, LEAST_M) ** 2, MOST_M**2)[:, None]
    share, near, gained = _shares(pairs, peak, turn, at, variance + drifted)
    # Information as the residuals have it, not as a Student-t would (a sandwich estimate, but for one number a pose).
    told = share * near / (variance + drifted) * variance
    seen = (told * told * pairs.squares(turn, at)).sum(axis=1) / variance[:, 0]
    doubt = (seen + DOUBT_WEIGHT) / np.maximum(told.sum(axis=1) + DOUBT_WEIGHT - 1.0, 1.0)
    weight = share * near / doubt[:, None]
    moved, covariance = _settled(pairs, weight, variance, age, unrest, drifts, turn, at)
    turn, at = turn * np.exp(1j * moved[:, 2]), at + moved[:, 0] + 1j * moved[:, 1]
    up, above = _height(pairs, share, variance)
    # The prior of the spread speaks for a drift too.
    fits = gained - USUAL_WEIGHT * (np.log(variance) + USUAL_M**2 / variance)[:, 0]
    return _together(fits.reshape(-1, t), gained, turn, at, up, covariance, above)


def _repeated(pairs: Pairs, numbers: int, times: int) -> Pairs:
    """The pairs of the same poses several times over."""
    at = [np.where(pairs.at < numbers, pairs.at + i * numbers, times * numbers) for i in range(times)]
    terms, peak, above = (np.concatenate([each] * times) for each in (pairs.terms, pairs.peak, pairs.above))
    return Pairs(terms, peak, above, np.concatenate(at), times * numbers + 1)


def _together(
    fits: Floats, gained: Floats, turn: Complex, at: Complex, up: Floats, covariance: Floats, above: Floats
) -> Refined:
    """Each pose as the drifts have it together, weighted by how well they explain what is seen, (drifts, T)."""
    times, t = fits.shape
    likely = np.exp(fits - fits.max(axis=0))
    likely /= likely.sum(axis=0)
    best = fits.argmax(axis=0)
    heading = turn.reshape(times, t)[best, np.arange(t)]
    off = np.stack([at.real, at.imag, np.angle(turn * np.tile(np.conj(heading), times))], axis=1).reshape(times, t, 3)
    mean = (likely[..., None] * off).sum(axis=0)
    off -= mean
    spread = covariance.reshape(times, t, 3, 3) + off[..., :, None] * off[..., None, :]
    whole = np.zeros((t, 4, 4))
    keep = np.array([0, 1, 3])
    whole[:, keep[:, None], keep] = (likely[..., None, None] * spread).sum(axis=0)
    whole[:, 2, 2] = above.reshape(times, t)[best, np.arange(t)]
    whole[:, np.arange(4), np.arange(4)] += FLOOR
    shift = np.stack([mean[:, 0], mean[:, 1], up.reshape(times, t)[best, np.arange(t)]], axis=1)
    score = gained.reshape(times, t)[best, np.arange(t)]
    return Refined(np.angle(heading) + mean[:, 2], shift, score, whole)


def _shares(pairs: Pairs, peak: Floats, turn: Complex, at: Complex, variance: Floats) -> tuple[Floats, Floats, Floats]:
    """(D, K) probability of each pair and the closeness of its two, in (0, 1]; (D,) log-likelihood ratio."""
    near = 1.0 / (1.0 + np.maximum(pairs.squares(turn, at), 0.0) / (FREEDOM * variance))
    odds = peak * near ** (FREEDOM // 2 + 1) / variance
    total = pairs.by_seen(odds) + 1.0
    gained = np.log(total[:-1]).reshape(len(turn), -1).sum(axis=1)
    return odds / total[pairs.at], near, gained


def _settled(
    pairs: Pairs,
    weight: Floats,
    variance: Floats,
    age: Floats,
    unrest: Floats,
    drifts: Floats,
    turn: Complex,
    at: Complex,
) -> tuple[Floats, Floats]:
    """(D, 3) what x, y and yaw are still to be moved by once drift is reckoned with; (D, 3, 3) covariance.

    Args:
        pairs: of D poses.
        weight: (D, K) of the pairs.
        variance: (D, 1) of their residuals, m².
        age: (D, K) metres walked since the seen object changed.
        unrest: (D, K) variance that a metre walked adds to where the seen object is, m².
        drifts: (D, 1) drift.
        turn: (D,) of the poses.
        at: (D,) the same.

    """
    groups = np.searchsorted(AGES_M, age, side="right")
    there = [(groups == group) & (weight > 0) for group in range(len(AGES_M) + 1)]
    youngest = np.array([age[each].min(initial=np.inf) for each in there])
    z = turn[:, None] * (pairs.terms[:, 0] + 1j * pairs.terms[:, 1])
    e = pairs.terms[:, 2] + 1j * pairs.terms[:, 3] - z - at[:, None]
    # What each pair says of the pose, in information form: J = [1, i z].
    parts = np.stack(
        [np.ones_like(weight), -z.imag, z.real, np.abs(z) ** 2, e.real, e.imag, z.real * e.imag - z.imag * e.real]
    )
    # Of a group each object is taken in when the youngest is; until then it has drifted by itself.
    parts *= weight / (variance + np.maximum(age - youngest[groups], 0.0) * unrest)
    drift = drifts[:, :, None] * np.diag([SHIFT_M**2, SHIFT_M**2, TURN_RAD**2])
    mean, known = np.zeros((len(turn), 3)), np.broadcast_to(WIDE, (len(turn), 3, 3))
    last = np.inf
    for group in range(len(AGES_M), -1, -1):
        if np.isinf(youngest[group]):
            continue
        if last < np.inf:
            known = known + drift * (last - youngest[group])
        last = youngest[group]
        w, wy, wx, wr, ex, ey, et = (parts * there[group]).sum(axis=2)
        zero = np.zeros_like(w)
        info = np.stack([w, zero, wy, zero, w, wx, wy, wx, wr], axis=1).reshape(-1, 3, 3)
        said = np.stack([ex, ey, et], axis=1) - (info @ mean[..., None])[..., 0]
        known = np.linalg.inv(np.eye(3) + known @ info) @ known
        mean = mean + (known @ said[..., None])[..., 0]
    if last < np.inf:
        known = known + drift * last
    return mean, 0.5 * (known + known.transpose(0, 2, 1))


def _height(pairs: Pairs, share: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """(T,) metres of the robot's place over the map's, by the objects' heights, and its variance."""
    up = np.zeros(len(share))
    for _ in range(3):
        off = pairs.above - up[:, None]
        weight = share / (variance + off * off / FREEDOM)
        total = weight.sum(axis=1) + 1.0 / HEIGHT_M**2
        up = (weight * pairs.above).sum(axis=1) / total
    return up, 1.0 / total
