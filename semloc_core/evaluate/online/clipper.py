"""CLIPPER, the field's standard for object maps, as a peer: the densest consistent set of same-class pairs.

P. C. Lusk and J. P. How, "CLIPPER: Robust Data Association without an Initial Guess", 2024. Objects seen and mapped are
paired where they are of one class; two pairs are consistent as far as the distance between the two objects is the same
on either side; the set of pairs with the most weight of consistency a pair, all of it mutually consistent, is sought by
projected gradient ascent on a relaxation whose penalty for inconsistency grows (the paper's Algorithm 1). A turn about
gravity and a shift are then fitted to the set in least squares.

Written from the paper, dense and in numpy: it answers as the original does and takes its time. What the original (C++)
costs must be measured on the original.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.graph import Floats, Ints
from semloc_core.map_merge import Transform, fit_transform
from semloc_core.text import short_repr

_FAINT = 1e-9
_CHANGE = 1e-8
_FAINT_AFFINITY = 1e-4
_BACK = 0.25


class ClipperConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When two pairs are consistent; the defaults suit objects in rooms."""

    sigma_m: Annotated[float, Meta(gt=0.0, description="standard deviation of a difference in distance")] = 0.4
    epsilon_m: Annotated[float, Meta(gt=0.0, description="pairs that differ by more are inconsistent")] = 0.8
    mindist_m: Annotated[float, Meta(ge=0.0, description="objects nearer to one another say nothing")] = 0.2
    ascents: Annotated[int, Meta(ge=1, description="most increases of the penalty")] = 1000
    steps: Annotated[int, Meta(ge=1, description="most gradient steps at one penalty")] = 200


@short_repr
@dataclass(frozen=True, eq=False)
class Registration:
    """A seen set of objects laid on a mapped one.

    Args:
        seen: (k,) indices of the seen objects that were chosen.
        mapped: (k,) the mapped object of each.
        score: the relaxation's value, about the number of mutually consistent pairs.
        transform: from the seen frame into the map's.

    """

    seen: Ints
    mapped: Ints
    score: float
    transform: Transform


def register_clipper(
    seen: Floats, seen_classes: Ints, mapped: Floats, mapped_classes: Ints, config: ClipperConfig | None = None
) -> Registration | None:
    """Lay seen objects on mapped ones.

    Args:
        seen: (n, 3) metres, in any frame whose z axis is upright.
        seen_classes: (n,) of these.
        mapped: (m, 3) metres.
        mapped_classes: (m,) of these.
        config: options.

    Returns:
        The registration; None where fewer than two pairs are consistent, so that no heading follows.

    """
    config = config or ClipperConfig()
    i, j = np.nonzero(np.equal.outer(seen_classes, mapped_classes))
    if len(i) < 2:
        return None
    chosen, score = densest(
        affinities(_distances(seen)[np.ix_(i, i)], _distances(mapped)[np.ix_(j, j)], config), config
    )
    if len(chosen) < 2:
        return None
    i, j = i[chosen], j[chosen]
    return Registration(i, j, score, fit_transform(seen[i], mapped[j], np.ones(len(i))))


Register = Callable[[Floats, Ints, Floats, Ints, ClipperConfig], Registration | None]


def original_clipper() -> Register | None:
    """The authors' own, in C++, as `register_clipper`; None where their package ``clipperpy`` is not installed."""
    try:
        peer: Any = import_module("clipperpy")
    except ModuleNotFoundError:
        return None

    def registered(
        seen: Floats, seen_classes: Ints, mapped: Floats, mapped_classes: Ints, config: ClipperConfig
    ) -> Registration | None:
        i, j = np.nonzero(np.equal.outer(seen_classes, mapped_classes))
        if len(i) < 2:
            return None
        invariant = peer.invariants.EuclideanDistanceParams()
        invariant.sigma, invariant.epsilon, invariant.mindist = config.sigma_m, config.epsilon_m, config.mindist_m
        solver = peer.CLIPPER(peer.invariants.EuclideanDistance(invariant), peer.Params())
        pairs = np.stack([i, j], axis=1).astype(np.int32, order="F")
        solver.score_pairwise_consistency(*(np.asfortranarray(points.T) for points in (seen, mapped)), pairs)
        solver.solve()
        i, j = solver.get_selected_associations().T
        if len(i) < 2:
            return None
        return Registration(i, j, solver.get_solution().score, fit_transform(seen[i], mapped[j], np.ones(len(i))))

    return registered


def affinities(first: Floats, second: Floats, config: ClipperConfig) -> Floats:
    """(p, p) how consistent each two of p pairs are, in [0, 1]; 0 is inconsistent, and so is the diagonal.

    Args:
        first: (p, p) distances between the pairs' seen objects, metres.
        second: (p, p) the same of their mapped ones.
        config: options.

    """
    off = np.abs(first - second)
    found: Floats = np.exp(-0.5 * (off / config.sigma_m) ** 2)
    found[(off >= config.epsilon_m) | (found <= _FAINT_AFFINITY)] = 0.0
    # Pairs that share an object are no distance apart on one side, whatever the least distance asked for.
    found[(first < config.mindist_m) | (second < config.mindist_m) | (first == 0.0) | (second == 0.0)] = 0.0
    np.fill_diagonal(found, 0.0)
    return found


def densest(affinity: Floats, config: ClipperConfig | None = None) -> tuple[Ints, float]:
    """The densest consistent set: indices, and the value of the relaxation (its size, were all of it consistent).

    Begins with equal weights, where the original draws them: a power step makes the two alike.

    Args:
        affinity: (p, p) symmetric, the diagonal zero; 0 forbids two to be in one set.
        config: options.

    """
    config = config or ClipperConfig()
    allowed = (affinity > 0).astype(np.float64)
    weight = affinity.sum(axis=1) + 1.0
    weight /= np.linalg.norm(weight)

    def gradient(u: Floats, penalty: float) -> Floats:
        found: Floats = affinity @ u + u + penalty * (allowed @ u + u - u.sum())
        return found

    penalty, value = _penalty(affinity, allowed, weight), 0.0
    for _ in range(config.ascents):
        slope = gradient(weight, penalty)
        value = float(weight @ slope)
        for _ in range(config.steps):
            after, slope, gained = _ascend(weight, slope, value, lambda u, d=penalty: gradient(u, d))  # type: ignore[misc]
            moved = float(np.linalg.norm(after - weight))
            weight, value = after, value + gained
            if moved < _CHANGE or abs(gained) < _FAINT:
                break
        more = _penalty(affinity, allowed, weight)
        if more == 0.0:
            break
        penalty += more
    size = min(round(value), len(weight))
    return np.sort(np.argsort(-np.round(weight, 9), kind="stable")[:size]), value


def _distances(points: Floats) -> Floats:
    found: Floats = np.linalg.norm(points[:, None] - points[None], axis=2)
    return found


def _penalty(affinity: Floats, allowed: Floats, weight: Floats) -> float:
    """By how much the penalty has to grow for what is inconsistent in (p,) weights; 0 where nothing is."""
    against = weight.sum() - allowed @ weight - weight
    active = (against > _FAINT) & (weight > _FAINT)
    if not active.any():
        return 0.0
    gain = affinity[active] @ weight + weight[active]
    return float(np.abs(gain / against[active]).mean())


def _ascend(
    weight: Floats, slope: Floats, value: float, gradient: Callable[[Floats], Floats]
) -> tuple[Floats, Floats, float]:
    """One step on the positive part of the sphere that does not lead down: weights, gradient there, what it gained."""
    step = 1.0
    for _ in range(99):
        after = np.maximum(weight + step * slope, 0.0)
        after /= max(float(np.linalg.norm(after)), _FAINT)  # nothing left of it: a step too far, which gains nothing
        there = gradient(after)
        gained = float(after @ there) - value
        if gained >= -_FAINT:
            break
        step *= _BACK
    return after, there, gained
