"""Poses refined, compiled: `pose.refine`, one pose after another.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import MapTable, SeenTable


@kernel
def refine(
    table: MapTable,
    seen: SeenTable,
    rows: Ints,
    heading: Floats,
    shift: Floats,
    tried: Floats,
    spreads: tuple[float, ...],
    bounds: tuple[float, ...],
    pairing: tuple[float, float, float, float],
    numbers: tuple[float, float, float, float, float, float, float, float, float],
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """What `pose.refine._together` puts together, of T poses by D drifts.

    Args:
        table: the map.
        seen: n objects.
        rows, heading, shift: (T,), (T,), (T, 2) the poses, as of `pose.refine.refine`.
        tried: (D,) drifts.
        spreads: `SPREADS_M` there.
        bounds: `AGES_M`.
        pairing: how far pairs reach in the plane, metres, and in height, spreads; both spreads, metres.
        numbers: `SHIFT_M`, `TURN_RAD`, `LEAST_M`, `MOST_M`, `USUAL_M`, `USUAL_WEIGHT`, `FREEDOM`, `DOUBT_WEIGHT` and
            `HEIGHT_M`.

    Returns:
        (D, T) how well each fits; (D, T) log-likelihood ratio; (D, T, 5) cosine and sine of the turn, shift in x and y,
        in height; (D, T, 3, 3) covariance; (D, T) variance in height.

    """
    objects, classes, ages, weights = seen
    reach, far, spread_m, height_spread_m = pairing
    shift_m, turn_rad, least_m, most_m, usual_m, usual_weight, freedom, doubted, height_m = numbers
    t_all, n, d_all = len(rows), len(classes), len(tried)
    first = np.zeros(t_all + 1, np.int64)
    # Of each pair: the seen object and the mapped one, how much higher that is, the odds, and which was seen.
    pairs, of = np.empty((256, 6)), np.empty(256, np.int64)
    k = 0
    for t in range(t_all):
        row, c, s = rows[t], math.cos(heading[t]), math.sin(heading[t])
        for e in range(table.start[row], table.start[row + 1]):
            o, kind = table.objects[e], table.classes[e]
            ox, oy, oz = (
                table.object_x[o] - table.x[row],
                table.object_y[o] - table.y[row],
                table.object_z[o] - table.z[row],
            )
            ax, ay = ox - shift[t, 0], oy - shift[t, 1]
            wx, wy = c * ax + s * ay, c * ay - s * ax
            for i in range(n):
                weight = 1.0
                if weights.shape[1] > 0:
                    weight = weights[i, kind]
                    if weight <= 0.0:
                        continue
                elif classes[i] != kind:
                    continue
                bx, by, over = wx - objects[i, 0], wy - objects[i, 1], (objects[i, 2] - oz) / height_spread_m
                if bx * bx + by * by > reach * reach or abs(over) > far:
                    continue
                if k == len(of):
                    more, many = np.empty((2 * k, 6)), np.empty(2 * k, np.int64)
                    more[:k], many[:k] = pairs, of
                    pairs, of = more, many
                pairs[k] = (
                    objects[i, 0],
                    objects[i, 1],
                    ox,
                    oy,
                    oz - objects[i, 2],
                    table.odds[o] * weight * spread_m**2,
                )
                pairs[k, 5] *= math.exp(-0.5 * over * over)
                of[k] = i
                k += 1
        first[t + 1] = k
    group, youngest = np.empty(k, np.int64), np.full(len(bounds) + 1, np.inf)
    for j in range(k):
        age, group[j] = ages[of[j]], 0
        for bound in bounds:
            group[j] += age >= bound
        youngest[group[j]] = min(youngest[group[j]], age)
    fits, gained, pose = np.empty((d_all, t_all)), np.empty((d_all, t_all)), np.empty((d_all, t_all, 5))
    covariance, height = np.empty((d_all, t_all, 3, 3)), np.empty((d_all, t_all))
    total, share, close = np.empty(n), np.empty(k), np.empty(k)
    spread, squares, told = np.empty(k), np.empty(k), np.empty(k)
    known_weight = usual_weight * 2 * usual_m**2
    for d in range(d_all):
        for t in range(t_all):
            low, high = first[t], first[t + 1]
            c, s, dx, dy = math.cos(heading[t]), math.sin(heading[t]), shift[t, 0], shift[t, 1]
            variance = spreads[0] ** 2
            _squares(squares, pairs, low, high, c, s, dx, dy)
            for j in range(low, high):
                lever = pairs[j, 0] ** 2 + pairs[j, 1] ** 2
                # By how much a metre walked spreads it, for now.
                told[j] = tried[d] * (shift_m**2 + turn_rad**2 * lever)
                spread[j] = variance + ages[of[j]] * told[j]
            for least in spreads:
                _shares(share, close, total, squares, spread, pairs, of, low, high, freedom)
                for j in range(low, high):
                    close[j] *= share[j] / spread[j]
                c, s, dx, dy = _fit(close, pairs, low, high)
                _squares(squares, pairs, low, high, c, s, dx, dy)
                found, number = known_weight, 0.0
                for j in range(low, high):
                    drifted = spread[j] - variance
                    found += (
                        (variance * (1.0 + 2.0 / freedom) * close[j] * squares[j] + 2.0 * share[j] * drifted)
                        * variance / spread[j]
                    )  # fmt: skip
                    number += share[j]
                found /= max(2.0 * (number + usual_weight) - 3.0, 1.0)
                before, floor = variance, max(least, least_m)
                variance = min(max(found, floor * floor), most_m * most_m)
                for j in range(low, high):
                    spread[j] += variance - before
            for j in range(low, high):
                spread[j] = variance + ages[of[j]] * told[j]
            gain = _shares(share, close, total, squares, spread, pairs, of, low, high, freedom)
            fits[d, t] = gain - usual_weight * (math.log(variance) + usual_m**2 / variance)
            gained[d, t] = gain
            said, doubt = 0.0, 0.0
            for j in range(low, high):
                weight = share[j] * close[j] * variance / spread[j]
                said += weight * weight * squares[j]
                doubt += weight
            doubt = (said / variance + doubted) / max(doubt + doubted - 1.0, 1.0)
            info = np.zeros((len(youngest), 7))
            for j in range(low, high):
                x, y = c * pairs[j, 0] - s * pairs[j, 1], s * pairs[j, 0] + c * pairs[j, 1]
                ax, ay = pairs[j, 2] - x - dx, pairs[j, 3] - y - dy
                of_group = group[j]
                # Of a group each object is taken in when the youngest is; until then it has drifted by itself.
                old = max(ages[of[j]] - youngest[of_group], 0.0)
                trust = share[j] * close[j] / doubt / (variance + old * told[j])
                info[of_group, 0] += trust
                info[of_group, 1] -= trust * y
                info[of_group, 2] += trust * x
                info[of_group, 3] += trust * (x * x + y * y)
                info[of_group, 4] += trust * ax
                info[of_group, 5] += trust * ay
                info[of_group, 6] += trust * (x * ay - y * ax)
            mean = _settled(info, youngest, tried[d], shift_m, turn_rad, covariance[d, t])
            turn = math.cos(mean[2]), math.sin(mean[2])
            pose[d, t, 0], pose[d, t, 1] = c * turn[0] - s * turn[1], c * turn[1] + s * turn[0]
            pose[d, t, 2], pose[d, t, 3] = dx + mean[0], dy + mean[1]
            up, weight = 0.0, 1.0
            for _ in range(3):
                raised, weight = 0.0, 1.0 / height_m**2
                for j in range(low, high):
                    off = pairs[j, 4] - up
                    trust = share[j] / (variance + off * off / freedom)
                    raised += trust * pairs[j, 4]
                    weight += trust
                up = raised / weight
            pose[d, t, 4], height[d, t] = up, 1.0 / weight
    return fits, gained, pose, covariance, height


@kernel
def _squares(into: Floats, pairs: Floats, low: int, high: int, c: float, s: float, dx: float, dy: float) -> None:
    """Squared distances of seen and mapped objects at a pose, m²."""
    for j in range(low, high):
        ax = c * pairs[j, 0] - s * pairs[j, 1] + dx - pairs[j, 2]
        ay = s * pairs[j, 0] + c * pairs[j, 1] + dy - pairs[j, 3]
        into[j] = ax * ax + ay * ay


@kernel
def _shares(
    share: Floats,
    close: Floats,
    total: Floats,
    squares: Floats,
    spread: Floats,
    pairs: Floats,
    of: Ints,
    low: int,
    high: int,
    freedom: float,
) -> float:
    """Probabilities of pairs and their closeness, as of `pose.refine.Near.shares`; the log-likelihood ratio."""
    total[:] = 1.0
    for j in range(low, high):
        close[j] = 1.0 / (1.0 + squares[j] / (freedom * spread[j]))
        share[j] = close[j] * close[j] * close[j] * pairs[j, 5] / spread[j]
        total[of[j]] += share[j]
    for j in range(low, high):
        share[j] /= total[of[j]]
    gained = 0.0
    for each in total:
        gained += math.log(each)
    return gained


@kernel
def _fit(weight: Floats, pairs: Floats, low: int, high: int) -> tuple[float, float, float, float]:
    """The pose that fits pairs in least squares, as of `pose.pairs.best_pose`: cosine, sine, shift."""
    total, ax, ay, bx, by, re, im = 1e-9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(low, high):
        w, x, y, u, v = weight[j], pairs[j, 0], pairs[j, 1], pairs[j, 2], pairs[j, 3]
        total += w
        ax += w * x
        ay += w * y
        bx += w * u
        by += w * v
        re += w * (x * u + y * v)
        im += w * (x * v - y * u)
    ax, ay, bx, by = ax / total, ay / total, bx / total, by / total
    re, im = re - total * (ax * bx + ay * by), im - total * (ax * by - ay * bx)
    size = math.sqrt(re * re + im * im)
    c, s = (re / size, im / size) if size > 0.0 else (1.0, 0.0)
    return c, s, bx - (c * ax - s * ay), by - (s * ax + c * ay)


@kernel
def _settled(info: Floats, youngest: Floats, tried: float, shift_m: float, turn_rad: float, known: Floats) -> Floats:
    """(3,) what a pose is still to be moved by, as of `pose.refine._settled`; ``known`` (3, 3) is its covariance."""
    mean, last = np.zeros(3), -1.0
    known[:] = np.eye(3)
    unrest = np.array([shift_m**2, shift_m**2, turn_rad**2]) * tried
    its, step = np.zeros((3, 3)), np.empty((3, 3))
    for group in range(len(youngest) - 1, -1, -1):
        if youngest[group] == np.inf:
            continue
        if last >= 0.0:
            for i in range(3):
                known[i, i] += unrest[i] * (last - youngest[group])
        last = youngest[group]
        one = info[group]
        its[0, 0] = its[1, 1] = one[0]
        its[0, 2] = its[2, 0] = one[1]
        its[1, 2] = its[2, 1] = one[2]
        its[2, 2] = one[3]
        for i in range(3):
            for j in range(3):
                step[i, j] = (i == j) + known[i, 0] * its[0, j] + known[i, 1] * its[1, j] + known[i, 2] * its[2, j]
        _solve(step, known)
        said = one[4:] - (its[:, 0] * mean[0] + its[:, 1] * mean[1] + its[:, 2] * mean[2])
        mean += known[:, 0] * said[0] + known[:, 1] * said[1] + known[:, 2] * said[2]
    if last >= 0.0:
        for i in range(3):
            known[i, i] += unrest[i] * last
    for i in range(3):
        for j in range(i):
            known[i, j] = known[j, i] = 0.5 * (known[i, j] + known[j, i])
    return mean


@kernel
def _solve(a: Floats, b: Floats) -> None:
    """Put a⁻¹ b in place of b, both (3, 3), by elimination with pivots; a is lost."""
    for i in range(3):
        best = i
        for j in range(i + 1, 3):
            if abs(a[j, i]) > abs(a[best, i]):
                best = j
        if best != i:
            for k in range(3):
                a[i, k], a[best, k] = a[best, k], a[i, k]
                b[i, k], b[best, k] = b[best, k], b[i, k]
        for j in range(3):
            if j != i:
                factor = a[j, i] / a[i, i]
                for k in range(3):
                    a[j, k] -= factor * a[i, k]
                    b[j, k] -= factor * b[i, k]
    for i in range(3):
        for k in range(3):
            b[i, k] /= a[i, i]
