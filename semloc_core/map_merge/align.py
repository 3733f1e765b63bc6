"""How a traversal lies on a building: a robust rigid, gravity-aligned transform, or none that the data support.

Places found by their embeddings say which objects may be which; pairs of such matches whose distances agree propose
transforms (RANSAC: Fischler and Bolles, 1981); each is judged by how many objects come to lie on one of their class,
and how unlikely that is by chance (Moisan and Stival, "A probabilistic criterion to detect rigid point matches",
IJCV 2004, weigh agreement likewise); the best are refined by weighted least squares.

What chance can do is measured, not assumed: the traversal's mirror image has the same objects at the same distances,
and no rigid transform lays it on its building. An alignment that is not clearly better than the mirror image's best
is not supported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import MapError
from semloc_core.graph import Floats, Ints
from semloc_core.map_merge.config import MergeConfig
from semloc_core.map_merge.transform import Transform, fit_transform
from semloc_core.text import percent, short_repr

START_GATE_M = 2.0
VERTICAL_GATE_M = 1.0
SHORTEST_PAIR_M = 2.0
NEAR_PLACE_M = 2.0
"""An object within this distance of a place lies where the building has places."""
KEPT = 20
STEPS = 8
MOST_PAIRS = 1_000_000
_AT_ONCE = 256


@short_repr
@dataclass(frozen=True, eq=False)
class Scene:
    """Objects and places to be laid on each other.

    Args:
        objects: (O, 3) metres.
        classes: (O,) one number a class, the same in both scenes.
        parents: (O,) a place of each object, -1 where it has none.
        places: (P, 3) metres.
        area: m² of free space.

    """

    objects: Floats
    classes: Ints
    parents: Ints
    places: Floats
    area: float


@short_repr
@dataclass(frozen=True, eq=False)
class Alignment:
    """A transform from the traversal's frame into the building's, and what speaks for it.

    Args:
        transform: the transform.
        pairs: (2, K) objects of the building over objects of the traversal that it lays on each other.
        residual_m: root mean square distance of these, horizontally.
        gate_m: distance up to which two objects are one, from the noise of these pairs.
        score: the pairs' surprise, nats: Σ -ln(chance that an object of the class lies so near), faded by distance.
        share: pairs over objects of the traversal that come to lie where the building has places.

    """

    transform: Transform
    pairs: Ints
    residual_m: float
    gate_m: float
    score: float
    share: float


def align(
    mapped: Scene, seen: Scene, similarity: NDArray[np.float32], config: MergeConfig, name: str = ""
) -> Alignment:
    """Lay a traversal on a building.

    Args:
        mapped: the building.
        seen: the traversal, in a frame of its own whose z axis is up.
        similarity: (P of the traversal, P of the building) of their places' embeddings.
        config: options.
        name: the building's, for errors.

    Raises:
        MapError: the alignment is not supported: too few objects agree, no more than by chance, or in two ways.

    """
    best = proposals(mapped, seen, similarity, config)
    where = f" on building {name!r}" if name else ""
    found = len(best[0].pairs[0]) if best else 0
    if found < config.min_objects:
        raise MapError(f"expected {config.min_objects} objects or more that agree{where} (got {found})")
    first = best[0]
    if first.share < config.min_share:
        wanted = f"{percent(config.min_share)} of the objects seen to agree{where}"
        raise MapError(f"expected {wanted} (got {percent(first.share)})")
    mirror = np.array([-1.0, 1.0, 1.0])
    image = Scene(seen.objects * mirror, seen.classes, seen.parents, seen.places * mirror, seen.area)
    chance = max((each.score for each in proposals(mapped, image, similarity, config)), default=0.0)
    if first.score < config.min_gain * chance:
        raise MapError(
            f"expected the traversal to fit{where} {config.min_gain:g} times as well as by chance "
            f"(got {first.score / chance:.2f} times)"
        )
    for other in best[1:]:
        if not _same(first.transform, other.transform, seen) and other.score > config.max_rival * first.score:
            raise MapError(
                f"expected one way to lay the traversal{where} "
                f"(got another that fits {percent(other.score / first.score)} as well)"
            )
    return first


def proposals(mapped: Scene, seen: Scene, similarity: NDArray[np.float32], config: MergeConfig) -> list[Alignment]:
    """Alignments that are not the same, best first; whether one is supported, `align` says."""
    ours, theirs = _putative(mapped, seen, similarity, config.candidates)
    yaw, shift = _hypotheses(mapped, seen, ours, theirs, config)
    if not len(yaw):
        return []
    weights = _surprise(mapped, seen)
    scores = _scores(mapped, seen, yaw, shift, weights)
    found: list[Alignment] = []
    tried: list[Transform] = []
    for row in np.argsort(-scores, kind="stable")[: 10 * KEPT]:
        x, y, z = shift[row].tolist()
        guess = Transform(float(yaw[row]), (x, y, z))
        if len(tried) == KEPT:
            break
        if any(_same(guess, other, seen) for other in tried):
            continue
        tried.append(guess)
        refined = _refine(mapped, seen, guess, weights, config)
        if refined is not None and not any(_same(refined.transform, other.transform, seen) for other in found):
            found.append(refined)
    return sorted(found, key=lambda one: -one.score)


def _putative(mapped: Scene, seen: Scene, similarity: NDArray[np.float32], n: int) -> tuple[Ints, Ints]:
    """(K,), (K,) objects of building and traversal of one class, the n whose places are most alike for each seen."""
    ours: list[Ints] = []
    theirs: list[Ints] = []
    for i in range(len(seen.objects)):
        alike = np.flatnonzero(mapped.classes == seen.classes[i])
        if not len(alike):
            continue
        score = np.zeros(len(alike), dtype=np.float32)
        if seen.parents[i] >= 0:
            score = np.where(mapped.parents[alike] >= 0, similarity[seen.parents[i], mapped.parents[alike]], 0.0)
        chosen = alike[np.argsort(-score, kind="stable")[:n]]
        ours.append(chosen)
        theirs.append(np.full(len(chosen), i))
    none = np.zeros(0, dtype=np.int64)
    return np.concatenate([none, *ours]), np.concatenate([none, *theirs])


def _hypotheses(mapped: Scene, seen: Scene, ours: Ints, theirs: Ints, config: MergeConfig) -> tuple[Floats, Floats]:
    """(H,) yaws and (H, 3) shifts from pairs of matches that agree in their distance."""
    a, b = mapped.objects[ours], seen.objects[theirs]
    rng = np.random.default_rng(config.seed)
    first, second = _pairs(len(ours), rng)
    in_map, in_run = a[second] - a[first], b[second] - b[first]
    long, there = np.hypot(in_map[:, 0], in_map[:, 1]), np.hypot(in_run[:, 0], in_run[:, 1])
    agree = (
        (np.abs(long - there) <= config.pair_tolerance_m)
        & (np.minimum(long, there) >= SHORTEST_PAIR_M)
        & (np.abs(in_map[:, 2] - in_run[:, 2]) <= config.pair_tolerance_m)
        & (ours[first] != ours[second])
        & (theirs[first] != theirs[second])
    )
    rows = np.flatnonzero(agree)
    if len(rows) > config.hypotheses:
        # Long pairs fix the yaw better and rare classes are seldom wrong.
        weight = _surprise(mapped, seen)[theirs]
        chance = weight[first[rows]] * weight[second[rows]] * np.sqrt(there[rows])
        rows = np.sort(rng.choice(rows, config.hypotheses, replace=False, p=chance / chance.sum()))
    p, q = in_run[rows], in_map[rows]
    yaw = np.arctan2(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1])
    middle = (b[first[rows]] + b[second[rows]]) / 2
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.stack([c * middle[:, 0] - s * middle[:, 1], s * middle[:, 0] + c * middle[:, 1], middle[:, 2]], axis=1)
    return yaw, (a[first[rows]] + a[second[rows]]) / 2 - turned


def _pairs(n: int, rng: np.random.Generator) -> tuple[Ints, Ints]:
    """All pairs of n things; of very many as many as can be looked at, drawn at random."""
    if n * (n - 1) // 2 <= MOST_PAIRS:
        first, second = np.triu_indices(n, 1)
        return first.astype(np.int64), second.astype(np.int64)
    drawn = rng.integers(n, size=(2, MOST_PAIRS))
    return drawn.min(axis=0), drawn.max(axis=0)


def _surprise(mapped: Scene, seen: Scene) -> Floats:
    """(O,) -ln of the chance that an object of its class lies within a metre of a spot in the building; of ``seen``."""
    count = np.bincount(mapped.classes, minlength=int(max(seen.classes.max(initial=0), 0)) + 1)[seen.classes]
    chance = np.clip(count * math.pi / max(mapped.area, 1.0), 1e-3, 0.9)
    surprise: Floats = -np.log(chance)
    return surprise


def _scores(mapped: Scene, seen: Scene, yaw: Floats, shift: Floats, weights: Floats) -> Floats:
    """(H,) how well each hypothesis lays objects on objects of their class; several may share one."""
    total = np.zeros(len(yaw))
    for start in range(0, len(yaw), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        c, s = np.cos(yaw[rows])[:, None], np.sin(yaw[rows])[:, None]
        x = c * seen.objects[:, 0] - s * seen.objects[:, 1] + shift[rows, :1]
        y = s * seen.objects[:, 0] + c * seen.objects[:, 1] + shift[rows, 1:2]
        z = seen.objects[:, 2] + shift[rows, 2:3]
        for class_ in np.unique(seen.classes):
            theirs, ours = seen.classes == class_, mapped.objects[mapped.classes == class_]
            if not len(ours):
                continue
            squared = (x[:, theirs, None] - ours[:, 0]) ** 2 + (y[:, theirs, None] - ours[:, 1]) ** 2
            squared[np.abs(z[:, theirs, None] - ours[:, 2]) > VERTICAL_GATE_M] = np.inf
            near = np.maximum(0.0, 1.0 - squared.min(axis=2)).sum(axis=1)
            total[rows] += weights[theirs][0] * np.minimum(near, len(ours))
    return total


def match_objects(mapped: Scene, seen: Scene, moved: Floats, gate_m: float) -> tuple[Ints, Floats]:
    """One-to-one matches within a class and a gate, of least total squared distance: (2, K) pairs and (K,) metres.

    Args:
        mapped: the building.
        seen: the traversal; its classes count.
        moved: (O, 3) its objects in the building's frame.
        gate_m: largest horizontal distance.

    """
    from scipy.optimize import linear_sum_assignment

    pairs: list[Ints] = [np.zeros((2, 0), dtype=np.int64)]
    metres: list[Floats] = [np.zeros(0)]
    for class_ in np.intersect1d(mapped.classes, seen.classes):
        ours, theirs = np.flatnonzero(mapped.classes == class_), np.flatnonzero(seen.classes == class_)
        apart = mapped.objects[ours][:, None] - moved[theirs]
        away = np.hypot(apart[..., 0], apart[..., 1])
        away[np.abs(apart[..., 2]) > VERTICAL_GATE_M] = np.inf
        a, b = linear_sum_assignment(np.minimum(away, gate_m) ** 2)
        kept = away[a, b] < gate_m
        pairs.append(np.stack([ours[a[kept]], theirs[b[kept]]]))
        metres.append(away[a, b][kept])
    return np.concatenate(pairs, axis=1), np.concatenate(metres)


def _refine(mapped: Scene, seen: Scene, guess: Transform, weights: Floats, config: MergeConfig) -> Alignment | None:
    """Match, fit, match again; the gate follows the noise."""
    from scipy.spatial import cKDTree

    transform, gate_m = guess, START_GATE_M
    for _ in range(STEPS):
        pairs, metres = match_objects(mapped, seen, transform.apply(seen.objects), gate_m)
        if pairs.shape[1] < 2:
            return None
        near = np.maximum(1e-3, 1.0 - (metres / gate_m) ** 2)
        transform = fit_transform(seen.objects[pairs[1]], mapped.objects[pairs[0]], weights[pairs[1]] * near)
        noise = 1.4826 * float(np.median(metres))  # of a Rayleigh distance this is 1.75 σ
        gate_m = float(np.clip(2.0 * noise, config.gate_low_m, config.gate_high_m))
    moved = transform.apply(seen.objects)
    pairs, metres = match_objects(mapped, seen, moved, gate_m)
    if not pairs.shape[1]:
        return None
    score = float((weights[pairs[1]] * np.maximum(0.0, 1.0 - metres**2)).sum())
    away = np.asarray(cKDTree(mapped.places).query(moved)[0])
    share = pairs.shape[1] / max(1, int(np.count_nonzero(away <= NEAR_PLACE_M)))
    residual = float(np.sqrt((metres**2).mean()))
    return Alignment(transform, pairs, residual, gate_m, score, min(1.0, share))


def _same(one: Transform, other: Transform, seen: Scene) -> bool:
    """Whether two transforms lay the traversal's objects in the same places, give or take a metre and a half."""
    apart = one.apply(seen.objects) - other.apply(seen.objects)
    return float(np.sqrt((apart**2).sum(axis=1).mean())) < 1.5
