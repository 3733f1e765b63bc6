"""Headings voted for and poses aligned, compiled: `pose.heading_vote` and `pose.align`, one pose after another.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import Floats32, MapTable, SeenTable

_LEAST = -60.0


@kernel
def exp(x: Floats, n: int) -> None:
    """Put e to the power of the first n of x, which are 0 or less, in their place.

    Without branches and calls, so that eight are made at once, of an array that has room for that: what comes after the
    first n is lost. The same bits on every processor. Relative error below 1e-11 down to e^-20.
    """
    for i in range(n, (n + 7) & ~7):
        x[i] = 0.0
    for i in range((n + 7) & ~7):
        r = max(x[i], _LEAST) * (1.0 / 256.0)
        # Taylor's series of e^r, then squared eight times.
        p = 1.0 / 720.0 + r * (1.0 / 5040.0)
        p = 1.0 / 120.0 + r * p
        p = 1.0 / 24.0 + r * p
        p = 1.0 / 6.0 + r * p
        p = 0.5 + r * p
        p = 1.0 + r * p
        p = 1.0 + r * p
        p *= p
        p *= p
        p *= p
        p *= p
        p *= p
        p *= p
        p *= p
        p *= p
        x[i] = p


@kernel
def by_class(classes: Ints, weights: Floats) -> tuple[Ints, Ints]:
    """Where each class's objects begin, and (…,) numbers of (n,) objects by the classes that they may be of."""
    n, c = weights.shape
    if c == 0:
        n = len(classes)
        for of in classes:
            c = max(c, of + 1)
    first = np.zeros(c + 1, np.int64)
    if weights.shape[1] == 0:
        for i in range(n):
            first[classes[i] + 1] += 1
    else:
        for i in range(n):
            for of in range(c):
                first[of + 1] += weights[i, of] > 0.0
    for of in range(c):
        first[of + 1] += first[of]
    members, at = np.empty(first[c], np.int64), first.copy()
    for i in range(n):
        if weights.shape[1] == 0:
            members[at[classes[i]]] = i
            at[classes[i]] += 1
        else:
            for of in range(c):
                if weights[i, of] > 0.0:
                    members[at[of]] = i
                    at[of] += 1
    return first, members


@kernel
def heading_scores(
    table: MapTable,
    voters: SeenTable,
    candidates: Ints,
    numbers: tuple[float, float, float, float],
    counts: tuple[int, int],
) -> Floats32:
    """(K, headings) as of `pose.heading_vote.heading_scores`, for (K,) rows of a map.

    Args:
        table: the map.
        voters: the objects that vote.
        candidates: (K,) rows.
        numbers: spreads in the plane and in height, metres, `NEAR` and `SHARP` there.
        counts: `BESIDE` and `HEADINGS`.

    """
    beside, headings = counts
    classes, weights = voters.classes, voters.weights
    x, y, up = voters.objects[:, 0].copy(), voters.objects[:, 1].copy(), voters.objects[:, 2].copy()
    spread_m, height_spread_m, near, sharp = numbers
    n, k = len(x), len(candidates)
    metres, bearing = np.sqrt(x * x + y * y), np.arctan2(y, x)
    step, factor = 2 * math.pi / headings, 1.0 / (spread_m * spread_m)
    limit, high = near * spread_m, near * height_spread_m
    scores = np.empty((k, headings), dtype=np.float32)
    total = np.empty((n, headings + 2 * beside))
    found, product, vote = np.empty(headings), np.empty(headings), np.empty(headings)
    said = np.empty(n, np.bool_)
    # Twice around, for those that begin near the end.
    cosine, sine = np.empty(2 * headings), np.empty(2 * headings)
    for h in range(2 * headings):
        cosine[h], sine[h] = math.cos(h * step), math.sin(h * step)
    mixed = weights.shape[1] > 0
    first, members = by_class(classes, weights)
    for at in range(k):
        row = candidates[at]
        said[:] = False
        for e in range(table.start[row], table.start[row + 1]):
            of, far, above = table.classes[e], table.metres[e], table.up[e]
            if of >= len(first) - 1:
                continue
            for member in range(first[of], first[of + 1]):
                i = members[member]
                along, over = metres[i] - far, up[i] - above
                if abs(along) > limit or abs(over) > high:
                    continue
                if not said[i]:
                    said[i], total[i] = True, 1.0
                o = table.objects[e]
                peak, ox, oy = table.odds[o], table.object_x[o] - table.x[row], table.object_y[o] - table.y[row]
                if mixed:
                    peak *= weights[i, of]
                along /= spread_m
                over /= height_spread_m
                less = -0.5 * (along * along + over * over)
                # sin² of half an angle is half of one less its cosine: as much as the squared distance says.
                scale = metres[i] * far * factor
                less -= scale
                c, s = (x[i] * ox + y[i] * oy) * factor, (x[i] * oy - y[i] * ox) * factor
                if 4.0 * scale >= sharp:
                    turn = table.bearing[e] - bearing[i]
                    first_h = int(np.rint(turn / step)) - beside
                    while first_h < 0:
                        first_h += headings
                    while first_h >= headings:
                        first_h -= headings
                    for j in range(2 * beside + 1):
                        vote[j] = less + c * cosine[first_h + j] + s * sine[first_h + j]
                    exp(vote, 2 * beside + 1)
                    for j in range(2 * beside + 1):
                        total[i, first_h + j] += peak * vote[j]
                else:
                    for h in range(headings):
                        vote[h] = less + c * cosine[h] + s * sine[h]
                    exp(vote, headings)
                    for h in range(headings):
                        total[i, h] += peak * vote[h]
        # Few logarithms of products instead of many.
        found[:], product[:], many = 0.0, 1.0, 1.0
        for i in range(n):
            if not said[i]:
                continue
            most = 1.0
            for h in range(2 * beside):
                total[i, h] += total[i, headings + h] - 1.0
            for h in range(headings):
                product[h] *= total[i, h]
                most = max(most, total[i, h])
            many *= most
            if many > 1e100:
                for h in range(headings):
                    found[h] += math.log(product[h])
                product[:], many = 1.0, 1.0
        for h in range(headings):
            scores[at, h] = found[h] + math.log(product[h])
    return scores


@kernel
def best_poses(
    table: MapTable, candidates: Ints, scores: Floats32, most: int, more: int, numbers: tuple[float, float]
) -> tuple[Ints, Ints]:
    """Candidates' numbers and numbers of headings of poses, as of `pose.heading_vote.best_poses`."""
    apart_m, tied = numbers
    k, headings = scores.shape
    place, heading, value = np.empty(k * headings, np.int64), np.empty(k * headings, np.int64), np.empty(k * headings)
    number, best = 0, 0.0
    for i in range(k):
        for h in range(headings):
            s = scores[i, h]
            if s > 0 and s >= scores[i, h + 1 - headings] and s >= scores[i, h - 1]:
                place[number], heading[number], value[number] = i, h, s
                number += 1
                best = max(best, s)
    some = 0
    for i in range(number):
        if value[i] >= best - tied:
            some += 1
    most = min(max(some, most), more * most)
    order = np.argsort(-value[:number], kind="mergesort")[: 8 * most]
    kept, at, of, turned = (
        np.empty(most, np.int64),
        np.empty((3, most)),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
    )
    n = 0
    for i in order:
        row, free = candidates[place[i]], True
        x, y, z, building = table.x[row], table.y[row], table.z[row], table.building[row]
        for j in range(n):
            if abs(at[0, j] - x) < apart_m and abs(at[1, j] - y) < apart_m and of[j] == building:
                away = abs(turned[j] - heading[i])
                if (away <= 2 or away >= headings - 2) and abs(at[2, j] - z) < apart_m:
                    free = False
                    break
        if free:
            kept[n], at[0, n], at[1, n], at[2, n], of[n], turned[n] = i, x, y, z, building, heading[i]
            n += 1
            if n == most:
                break
    return place[kept[:n]], heading[kept[:n]]


@kernel
def align(
    table: MapTable,
    seen: SeenTable,
    rows: Ints,
    heading: Floats,
    numbers: tuple[float, float, float, float, float],
    narrower: tuple[float, ...],
    counts: tuple[int, int, int],
) -> tuple[Floats, Floats, Floats]:
    """Turns and shifts, rises and explained of T poses, as of `pose.align.align`.

    Args:
        table: the map.
        seen: n objects.
        rows: (T,) of the map.
        heading: (T,) radians.
        numbers: spreads of objects, of the robot and of heights, metres, `FAR` and `FARTHER` there.
        narrower: `NARROWER`.
        counts: `ROUNDS`, `MORE_ROUNDS` and `FREE`.

    Returns:
        (T, 4) cosine and sine of the turn, shift in x and y; (T,) rise; (T, n) explained.

    """
    objects, classes, weights = seen.objects, seen.classes, seen.weights
    spread_m, off_m, height_spread_m, far, farther = numbers
    rounds, more_rounds, free = counts
    t_all, n = len(rows), len(classes)
    pose, rise = np.empty((t_all, 4)), np.empty(t_all)
    explained = np.empty((t_all, n))
    mixed = weights.shape[1] > 0
    first, members = by_class(classes, weights)
    reach = far * (off_m + spread_m)
    anchor = (spread_m / off_m) ** 2
    size = 64
    sx, sy, yx, yy = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    peak, above, share = np.empty(size), np.empty(size), np.empty(size)
    wide, mixture, kept_share = np.empty(size), np.empty(size), np.empty(size)
    of = np.empty(size, np.int64)
    total, gain = np.empty(n), np.empty(n)
    for t in range(t_all):
        row = rows[t]
        c, s = math.cos(heading[t]), math.sin(heading[t])
        dx, dy = 0.0, 0.0
        k = 0
        px, py, pz = table.x[row], table.y[row], table.z[row]
        for e in range(table.start[row], table.start[row + 1]):
            o, kind = table.objects[e], table.classes[e]
            ox, oy, oz = table.object_x[o] - px, table.object_y[o] - py, table.object_z[o] - pz
            # As a robot with this heading has it.
            wx, wy = c * ox + s * oy, c * oy - s * ox
            if kind >= len(first) - 1:
                continue
            for member in range(first[kind], first[kind + 1]):
                i = members[member]
                ax, ay = wx - objects[i, 0], wy - objects[i, 1]
                if ax * ax + ay * ay > reach * reach:
                    continue
                over = (objects[i, 2] - oz) / height_spread_m
                if abs(over) > far:
                    continue
                if k == size:
                    size *= 2
                    sx, sy, yx, yy = _longer(sx), _longer(sy), _longer(yx), _longer(yy)
                    peak, above, share = _longer(peak), _longer(above), _longer(share)
                    wide, mixture, kept_share = _longer(wide), _longer(mixture), _longer(kept_share)
                    longer = np.empty(size, np.int64)
                    longer[:k] = of
                    of = longer
                sx[k], sy[k], yx[k], yy[k] = objects[i, 0], objects[i, 1], ox, oy
                above[k], of[k] = oz - objects[i, 2], i
                peak[k] = table.odds[o] * math.exp(-0.5 * over * over)
                if mixed:
                    peak[k] *= weights[i, kind]
                k += 1
        factor = -0.5 / spread_m**2
        for _ in range(rounds):
            _odds(wide, sx, sy, yx, yy, k, c, s, dx, dy, factor)
            total[:] = 1.0
            for j in range(k):
                wide[j] *= peak[j]
                total[of[j]] += wide[j]
            for j in range(k):
                share[j] = wide[j] / total[of[j]]
            c, s, dx, dy = _fit(share, sx, sy, yx, yy, k, anchor)
        _odds(wide, sx, sy, yx, yy, k, c, s, dx, dy, factor)
        total[:] = 0.0
        for j in range(k):
            total[of[j]] += wide[j] * peak[j]
        value = 0.0
        for i in range(n):
            gain[i] = math.log1p(total[i])
            value += gain[i]
        for j in range(k):
            kept_share[j] = wide[j] * peak[j] / (total[of[j]] + 1.0)
        explained[t] = gain
        pose[t, 0], pose[t, 1], pose[t, 2], pose[t, 3] = c, s, dx, dy
        for narrow in narrower:
            square = narrow * narrow
            times = (1.0 - farther) / square
            power = int(np.rint(1.0 / square))
            for around in range(more_rounds + 1):
                # Of the wide spread's density the narrower one's is a power.
                total[:] = 0.0
                for j in range(k):
                    mixture[j] = times * _power(wide[j], power)
                    total[of[j]] += (mixture[j] + farther * wide[j]) * peak[j]
                if around == more_rounds:
                    break
                for j in range(k):
                    share[j] = (mixture[j] + square * farther * wide[j]) * peak[j] / (total[of[j]] + 1.0)
                c, s, dx, dy = _fit(share, sx, sy, yx, yy, k, square * anchor)
                _odds(wide, sx, sy, yx, yy, k, c, s, dx, dy, factor)
            gained = 0.0
            for i in range(n):
                gain[i] = math.log1p(total[i])
                gained += gain[i]
            net = gained + free * math.log(narrow)
            if net > value:
                value = net
                for i in range(n):
                    explained[t, i] = gain[i] * (net / gained)
                for j in range(k):
                    kept_share[j] = (mixture[j] + farther * wide[j]) * peak[j] / (total[of[j]] + 1.0)
                pose[t, 0], pose[t, 1], pose[t, 2], pose[t, 3] = c, s, dx, dy
        up, weight = 0.0, 1.0
        for j in range(k):
            up += kept_share[j] * above[j]
            weight += kept_share[j]
        rise[t] = up / weight
    return pose, rise, explained


@kernel
def _longer(values: Floats) -> Floats:
    longer = np.empty(2 * len(values))
    longer[: len(values)] = values
    return longer


@kernel
def _power(base: float, exponent: int) -> float:
    """Of an exponent that is a power of two."""
    while exponent > 1:
        base *= base
        exponent >>= 1
    return base


@kernel
def _odds(
    into: Floats,
    sx: Floats,
    sy: Floats,
    yx: Floats,
    yy: Floats,
    k: int,
    c: float,
    s: float,
    dx: float,
    dy: float,
    factor: float,
) -> None:
    """Densities of k pairs, 1 where both are at one point: of seen objects at a pose, and mapped ones."""
    for j in range(k):
        ax, ay = c * sx[j] - s * sy[j] + dx - yx[j], s * sx[j] + c * sy[j] + dy - yy[j]
        into[j] = factor * (ax * ax + ay * ay)
    exp(into, k)


@kernel
def _fit(
    weight: Floats, sx: Floats, sy: Floats, yx: Floats, yy: Floats, k: int, anchor: float
) -> tuple[float, float, float, float]:
    """The pose that fits k pairs in least squares, as of `pose.pairs.best_pose`: cosine, sine, shift."""
    total, ax, ay, bx, by, re, im = anchor, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(k):
        w, x, y, u, v = weight[j], sx[j], sy[j], yx[j], yy[j]
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
