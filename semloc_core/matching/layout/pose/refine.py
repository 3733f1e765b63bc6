"""Poses that were tested, made exact to centimetres and degrees, and how exact they are.

The test's alignment is wide, so that it finds its way, and pulls towards the map's place. From there on the objects
alone decide: a seen object lies where the map has it but for a Student-t error in the plane (most are small, some are
large: a detector's, or things that were moved), or is invented. Expectation–maximisation begins with a wide spread,
which narrows to what the residuals say (graduated non-convexity), under a prior.

What was seen long ago was written in a frame that has drifted since, as a random walk in the way walked: the oldest
objects are taken in first, and what they say is spread before newer ones are (a Kalman filter in information form, over
the objects' ages). How much the frame drifts is not known: some drifts are tried, and weighted by how well they explain
the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.align import Pairs, fit, pairs_at
from semloc_core.matching.layout.pose.local_map import Complex, around_rows

REACH_M = 1.5
"""Pairs that are further apart at the pose to begin with are none."""
SPREADS_M = (0.5, 0.3, 0.2, 0.0, 0.0, 0.0)
"""The least spread in each round of expectation–maximisation."""
USUAL_M = 0.15
"""Standard deviation of an object, per axis, before its fellows' residuals are known."""
USUAL_WEIGHT = 4.0
"""So many objects' residuals that is worth."""
LEAST_M, MOST_M = 0.03, 0.5
"""Bounds of the spread."""
FREEDOM = 4
"""Degrees of freedom of the errors' Student-t distribution; the powers below are written for it."""
DRIFTS = (0.0, 1.0)
"""Drifts that are tried, as variances: 1 is that of the next two."""
TURN_RAD, SHIFT_M = np.radians(0.5), 0.03
"""Standard deviations of the turn and, per axis, of the shift of a frame that drifts, after one metre walked."""
AGES_M = (1.0, 4.0, 12.0)
"""Where objects are parted by their ages, metres walked."""
WIDE = np.diag([1.0, 1.0, 1.0])
"""Inverse covariance of what is known before any object is looked at, x, y (m) and yaw."""
HEIGHT_M = 0.5
"""Standard deviation of the robot's place over the map's: both are of one storey."""
FLOOR = np.array([0.01, 0.01, 0.01, np.radians(0.1)]) ** 2
"""Variances that nothing is known better than."""


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
    # The pairs' odds are those of the test's spread.
    peak = pairs.peak * mapped.config.spread_m**2
    flat = pairs.terms[:, 0] ** 2 + pairs.terms[:, 1] ** 2
    age = np.append(fragment.ages, 0.0)[np.where(pairs.at < t * n, pairs.at % max(n, 1), n)]
    drifted = age * (SHIFT_M**2 + TURN_RAD**2 * flat)
    variance = np.full((t, 1), SPREADS_M[0] ** 2)
    for least in SPREADS_M:
        share, near = _shares(pairs, peak, turn, at, variance + drifted)[:2]
        turn, at = fit(pairs, share * near / (variance + drifted), 1e-9)
        squares = pairs.squares(turn, at)
        # A Student-t's own estimate of its spread, three of the residuals' directions spent on the pose.
        total = (1.5 * share * near * squares * variance / (variance + drifted)).sum(axis=1)
        known = USUAL_WEIGHT * 2 * USUAL_M**2
        found = (total + known) / np.maximum(2 * (share.sum(axis=1) + USUAL_WEIGHT) - 3.0, 1.0)
        variance = np.clip(found, max(least, LEAST_M) ** 2, MOST_M**2)[:, None]
    share, near, gained = _shares(pairs, peak, turn, at, variance + drifted)
    moved, covariance = _settled(pairs, share * near / variance, age, turn, at)
    turn, at = turn * np.exp(1j * moved[:, 2]), at + moved[:, 0] + 1j * moved[:, 1]
    up, up_variance = _height(pairs, share, variance)
    whole = np.zeros((t, 4, 4))
    keep = np.array([0, 1, 3])
    whole[:, keep[:, None], keep] = covariance
    whole[:, 2, 2] = up_variance
    whole[:, np.arange(4), np.arange(4)] += FLOOR
    return Refined(np.angle(turn), np.stack([at.real, at.imag, up], axis=1), gained, whole)


def _shares(pairs: Pairs, peak: Floats, turn: Complex, at: Complex, variance: Floats) -> tuple[Floats, Floats, Floats]:
    """(T, K) probability of each pair and the closeness of its two, in (0, 1]; (T,) log-likelihood ratio."""
    near = 1.0 / (1.0 + np.maximum(pairs.squares(turn, at), 0.0) / (FREEDOM * variance))
    odds = peak * near**3 / variance
    total = pairs.by_seen(odds) + 1.0
    gained = np.log(total[:-1]).reshape(len(turn), -1).sum(axis=1)
    return odds / total[pairs.at], near, gained


def _settled(pairs: Pairs, weight: Floats, age: Floats, turn: Complex, at: Complex) -> tuple[Floats, Floats]:
    """(T, 3) what x, y and yaw are still to be moved by once drift is reckoned with; (T, 3, 3) covariance.

    Args:
        pairs: of T poses.
        weight: (T, K) of the pairs' residuals, per m².
        age: (T, K) metres walked since the seen object changed.
        turn: (T,) of the poses.
        at: (T,) the same.

    """
    t = len(turn)
    z = turn[:, None] * (pairs.terms[:, 0] + 1j * pairs.terms[:, 1])
    e = pairs.terms[:, 2] + 1j * pairs.terms[:, 3] - z - at[:, None]
    # What each pair says of the pose, in information form; J = [1, i z].
    parts = np.stack(
        [np.ones_like(weight), -z.imag, z.real, np.abs(z) ** 2, e.real, e.imag, z.real * e.imag - z.imag * e.real]
    )
    groups = np.searchsorted(AGES_M, age, side="right")
    drift = np.array(DRIFTS)[:, None, None, None] * np.diag([SHIFT_M**2, SHIFT_M**2, TURN_RAD**2])
    before = np.broadcast_to(np.linalg.inv(WIDE), (len(DRIFTS), t, 3, 3))
    mean, fits = np.zeros((len(DRIFTS), t, 3)), np.zeros((len(DRIFTS), t))
    last: Floats | None = None
    for group in range(len(AGES_M), -1, -1):
        its = np.where(groups == group, weight, 0.0)
        total = its.sum(axis=1)
        if not total.any():
            continue
        years = np.divide((its * age).sum(axis=1), total, out=np.zeros(t), where=total > 0)
        years = np.where(total > 0, years, years.max() if last is None else last)
        if last is not None:
            years = np.minimum(years, last)
            before = before + drift * (last - years)[:, None, None]
        last = years
        w, wy, wx, wr, ex, ey, et = (parts * its).sum(axis=2)
        info = np.zeros((t, 3, 3))
        info[:, 0, 0] = info[:, 1, 1] = w
        info[:, 0, 2] = info[:, 2, 0] = wy
        info[:, 1, 2] = info[:, 2, 1] = wx
        info[:, 2, 2] = wr
        said = np.stack([ex, ey, et], axis=1) - (info @ mean[..., None])[..., 0]
        gain = np.linalg.inv(np.eye(3) + before @ info)
        after = gain @ before
        step = (after @ said[..., None])[..., 0]
        known = np.stack([ex, ey, et], axis=1)
        fits += 0.5 * (said * step).sum(axis=2) + 0.5 * np.log(np.abs(np.linalg.det(gain)))
        fits += (mean * (0.5 * known + 0.5 * said)).sum(axis=2)
        mean, before = mean + step, after
    if last is not None:
        before = before + drift * last[:, None, None]
    likely = np.exp(fits - fits.max(axis=0))
    likely /= likely.sum(axis=0)
    best = (likely[..., None] * mean).sum(axis=0)
    off = mean - best
    spread = before + off[..., :, None] * off[..., None, :]
    covariance: Floats = (likely[..., None, None] * spread).sum(axis=0)
    return best, 0.5 * (covariance + covariance.transpose(0, 2, 1))


def _height(pairs: Pairs, share: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """(T,) metres of the robot's place over the map's, by the objects' heights, and its variance."""
    up = np.zeros(len(share))
    for _ in range(3):
        off = pairs.above - up[:, None]
        weight = share / (variance + off * off / FREEDOM)
        total = weight.sum(axis=1) + 1.0 / HEIGHT_M**2
        up = (weight * pairs.above).sum(axis=1) / total
    return up, 1.0 / total
