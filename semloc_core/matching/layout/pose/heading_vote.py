"""Which heading would make the objects around the robot lie as those around a place of the map do.

Every pair of a seen object and a mapped one of its class votes for the headings that bring one near the other
(a Hough transform over one angle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.building.objects_by_place import Floats32, around_m, sums
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.compiled.tables import SeenTable
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout

HEADINGS = 24
"""Headings that are tried, evenly around."""
STEP = 2 * np.pi / HEADINGS
BESIDE = 3
"""Steps to either side of the best heading of a pair that is far from the robot, that it votes for."""
SHARP = 35.0
"""A pair is far where, at `BESIDE` steps, it votes with less than a thirteenth of its weight."""
NEAR = 2.5
"""Pairs whose distances from their places differ by more spreads than this do not vote."""
VOTERS = 16
"""Seen objects that vote, those of the rarest classes: they have the fewest to be mistaken for."""
TIED, MORE = 3.0, 4
"""Poses tie whose scores differ by no more, nats; up to so many times the usual number of them are kept."""
_ROWS = HEADINGS + 2 * BESIDE
_BLOCK = 64
_AT_ONCE = 8
"""So many odds are multiplied before their logarithm is taken: far from what a float holds."""


def heading_scores(mapped: MappedLayout, fragment: Fragment, candidates: Ints) -> Floats32:
    """(K, HEADINGS) float32 log-likelihood ratio of the seen objects: as mapped, against all invented.

    Args:
        mapped: the map.
        fragment: what is around the robot, n objects.
        candidates: (K,) rows of the map.

    """
    weights = None if fragment.likely is None else mapped.weights(fragment.likely)
    # An object that may be of several classes is as rare as the one that has the best odds.
    rarity = mapped.invented[fragment.classes] if weights is None else 1 / (weights / mapped.invented).max(axis=1)
    voters = np.argsort(rarity, kind="stable")[:VOTERS]
    if compiled():
        return _compiled(mapped, fragment, voters, candidates, weights)
    k, n = len(candidates), len(voters)
    pairs = _pairs(mapped, fragment, voters, candidates, None if weights is None else weights[voters])
    # Far from the robot a heading that is off by a few steps misses.
    far = pairs.scale >= np.float32(SHARP)
    sharp, blunt = np.flatnonzero(far), np.flatnonzero(~far)
    turn = pairs.turn.take(sharp)
    nearest = np.rint(turn * np.float32(1 / STEP))
    turn -= nearest * np.float32(STEP)
    first = nearest.astype(np.int64) % HEADINGS * (n * k) + pairs.row.take(sharp)
    # Both kinds of votes are put where they are counted: there are many.
    split = len(_BESIDE) * len(sharp)
    at = np.empty(split + len(_AROUND) * len(blunt), dtype=np.int64)
    votes = np.empty(len(at), dtype=np.float32)
    np.add(first, _above(_BESIDE, n * k), out=at[:split].reshape(len(_BESIDE), -1))
    np.add(pairs.row.take(blunt) + BESIDE * n * k, _above(_AROUND, n * k), out=at[split:].reshape(len(_AROUND), -1))
    pairs.vote(sharp, turn, _BESIDE, votes[:split].reshape(len(_BESIDE), -1))
    pairs.vote(blunt, pairs.turn.take(blunt), _AROUND, votes[split:].reshape(len(_AROUND), -1))
    odds = sums(at, votes, _ROWS * n * k).reshape(_ROWS, n, k)
    # Headings before the first and after the last are those at the other end.
    odds[HEADINGS : HEADINGS + BESIDE] += odds[:BESIDE]
    odds[BESIDE : 2 * BESIDE] += odds[HEADINGS + BESIDE :]
    odds = odds[BESIDE : BESIDE + HEADINGS]
    odds += 1.0
    # The logarithm of a product is the sum that is wanted, and one logarithm costs as much as many products.
    gained = np.zeros((HEADINGS, k))
    for i in range(0, n, _AT_ONCE):
        gained += np.log(np.multiply.reduce(odds[:, i : i + _AT_ONCE], axis=1))
    return gained.T.astype(np.float32, order="C")


def _compiled(
    mapped: MappedLayout, fragment: Fragment, voters: Ints, candidates: Ints, weights: Floats | None
) -> Floats32:
    """As of `heading_scores`."""
    from semloc_core.matching.layout.compiled import poses

    config = mapped.config
    seen = SeenTable(
        fragment.objects[voters],
        fragment.classes[voters],
        fragment.ages[voters],
        np.zeros((0, 0)) if weights is None else weights[voters],
    )
    numbers = config.spread_m, config.height_spread_m, NEAR, SHARP
    return poses.heading_scores(mapped.table, seen, candidates, numbers, (BESIDE, HEADINGS))


def _above(halves: Floats32, size: int) -> Ints:
    """(S, 1) where S headings begin, from the first, in a table of headings over ``size`` numbers."""
    return (np.arange(len(halves)) * size)[:, None]


def _halves(steps: Ints) -> Floats32:
    """(S, 2) float32 cosine and negative sine of half of each heading."""
    return np.stack([np.cos(steps * STEP / 2), -np.sin(steps * STEP / 2)], axis=1).astype(np.float32)


_BESIDE, _AROUND = _halves(np.arange(-BESIDE, BESIDE + 1)), _halves(np.arange(HEADINGS))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """P pairs of a voter and a mapped object of its class, about as far from the candidate.

    Args:
        row: (P,) the voter and the candidate in one: voters times K, and the candidate.
        odds: (P,) float32, the vote for the heading that brings them into one direction, were they as far and as high.
        less: (P,) float32, logarithm of what is left of it since they are not.
        turn: (P,) float32 radians, that heading.
        scale: (P,) float32, how sharply they miss one another where the heading is off.

    """

    row: Ints
    odds: Floats32
    less: Floats32
    turn: Floats32
    scale: Floats32

    def vote(self, chosen: Ints, turn: Floats32, halves: Floats32, votes: Floats32) -> None:
        """Put into (S, p) the votes of p pairs that are off by (p,) turn, for S headings."""
        half = turn * np.float32(0.5)
        np.einsum("sk,kp->sp", halves, np.stack([np.sin(half), np.cos(half)]), out=votes)
        votes *= votes
        votes *= self.scale.take(chosen) * np.float32(-0.5)
        votes += self.less.take(chosen)
        np.exp(votes, out=votes)
        votes *= self.odds.take(chosen)


def _pairs(mapped: MappedLayout, fragment: Fragment, voters: Ints, candidates: Ints, weights: Floats | None) -> _Pairs:
    config, around = mapped.config, mapped.around
    x, y, up = fragment.objects[voters].T.astype(np.float32)
    metres, bearing = np.sqrt(x * x + y * y), np.arctan2(y, x)
    which, at = around.of_places(candidates)
    if weights is None:
        kind, of_class = mapped.kinds(fragment.classes[voters])
    else:  # of one kind as it were: whether a voter may be of a mapped one's class is asked of those about as far
        kind, of_class = np.zeros(len(voters), dtype=np.int32), np.where((weights > 0).any(axis=0), 0, -1)
    there = of_class.take(around.classes.take(at))
    wanted = np.flatnonzero(there >= 0)
    which, at, there = which.take(wanted), at.take(wanted), there.take(wanted)
    # Kinds are laid out along a line, far from one another: then only those of one kind can be about as far.
    limit = np.float32(NEAR * config.spread_m)
    apart = np.float32(around_m(config)) + limit + np.float32(1.0)
    off = np.subtract.outer(kind * apart + metres, there * apart + around.metres.take(at))
    np.abs(off, out=off)
    seen, entry = np.divmod(np.flatnonzero(off <= limit + np.float32(0.01)), len(at))
    at = at.take(entry)
    along, above = metres.take(seen) - around.metres.take(at), up.take(seen) - around.up.take(at)
    near = (np.abs(along) <= limit) & (np.abs(above) <= np.float32(NEAR * config.height_spread_m))
    weight = None if weights is None else weights[seen, around.classes.take(at)]
    close = np.flatnonzero(near if weight is None else near & (weight > 0))
    at, entry, seen = at.take(close), entry.take(close), seen.take(close)
    along, above = (
        along.take(close) * np.float32(1 / config.spread_m),
        above.take(close) * np.float32(1 / config.height_spread_m),
    )
    odds = mapped.odds.take(around.objects.take(at))
    if weight is not None:
        odds *= weight.take(close)
    return _Pairs(
        seen * len(candidates) + which.take(entry),
        odds.astype(np.float32),
        (along * along + above * above) * np.float32(-0.5),
        around.bearing.take(at) - bearing.take(seen),
        metres.take(seen) * around.metres.take(at) * np.float32(4.0 / config.spread_m**2),
    )


def best_poses(
    mapped: MappedLayout, candidates: Ints, scores: Floats32, most: int, apart_m: float
) -> tuple[Ints, Ints]:
    """The best poses, none near a better one.

    Args:
        mapped: the map.
        candidates: (K,) rows of it.
        scores: (K, HEADINGS) of these.
        most: how many; up to `MORE` times as many where so many tie.
        apart_m: two candidates nearer than this, with headings less than two steps apart, are one pose.

    Returns:
        (T,) candidates' numbers and (T,) numbers of headings, best first.

    """
    if compiled():
        from semloc_core.matching.layout.compiled import poses

        return poses.best_poses(mapped.table, candidates, scores, most, MORE, (apart_m, TIED))
    positions, building = mapped.positions[candidates], mapped.building[candidates]
    around = np.concatenate([scores[:, -1:], scores, scores[:, :1]], axis=1)
    peaks = np.flatnonzero((scores >= around[:, :-2]) & (scores >= around[:, 2:]) & (scores > 0))
    value = scores.ravel()[peaks]
    most = with_ties(value, most)
    if len(peaks) > 8 * most:
        some = np.flatnonzero(value >= np.partition(value, -8 * most)[-8 * most])
        peaks, value = peaks[some], value[some]
    order = np.argsort(-value, kind="stable")[: 8 * most]
    place, heading = np.divmod(peaks[order], HEADINGS)
    at, of, step = positions[place].T.copy(), building[place], heading.astype(np.int8)
    kept: list[int] = []
    for first in range(0, len(place), _BLOCK):
        block, with_ = slice(first, first + _BLOCK), [*kept, *range(first, min(first + _BLOCK, len(place)))]
        turned = np.abs(np.subtract.outer(step[with_], step[block]))
        same = (turned <= 2) | (turned >= HEADINGS - 2)
        same &= of[with_][:, None] == of[block]
        for axis in at:
            off = np.subtract.outer(axis[with_], axis[block])
            same &= np.abs(off, out=off) < apart_m
        beaten = np.logical_or.reduce(same[: len(kept)], axis=0)
        for i, others in enumerate(same[len(kept) :]):
            if not beaten[i]:
                kept.append(first + i)
                beaten |= others
        if len(kept) >= most:
            break
    del kept[most:]
    return place[kept], heading[kept]


def with_ties(values: Floats | Floats32, most: int) -> int:
    """How many poses are kept, by their (T,) scores, where it is to be so many: more where so many tie."""
    if not len(values):
        return 0
    return int(np.clip((values >= values.max() - TIED).sum(), most, MORE * most))
