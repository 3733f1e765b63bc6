"""Pairs of a seen and a mapped object that may be one, for many poses at once, and the pose that fits them best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.building.objects_by_place import sums
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.local_map import Complex, There
from semloc_core.text import short_repr

FAR = 3.0
"""Pairs that are further apart to begin with than so many standard deviations are none."""


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
    return best_pose(x, y, both, moments[:, 6] + anchor)


def best_pose(x: Complex, y: Complex, both: Complex, total: Floats) -> tuple[Complex, Complex]:
    """Turns and shifts in least squares, of weighted sums of any shape: the points x, y, x̄y and the weights, > 0."""
    x, y = x / total, y / total
    # Σ w (x − x̄)(y − ȳ), x conjugated, an anchor (x = y = 0) in the total among them.
    turn = both - total * np.conj(x) * y
    size = np.abs(turn)
    turn = np.divide(turn, size, out=np.ones_like(turn), where=size > 0)
    return turn, y - turn * x
