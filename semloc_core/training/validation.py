"""The validation split: how good the encoder is on places it was not trained on, and the temperature it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from semloc_core.encoding import Encoder, similarity_matrix
from semloc_core.graph import Floats
from semloc_core.metrics import pr_auc
from semloc_core.text import short_repr
from semloc_core.training.config import TrainConfig
from semloc_core.training.losses import build_loss, ignore_radius
from semloc_core.training.split import Bools, Part
from semloc_core.training.views.variants import Variant, pair_masks

Located = list[tuple[int, Floats]]
"""Blocks of rows: the building they are in, and (b, 3) positions in metres."""
TEMPERATURES = (1e-4, 10.0)
"""Bounds of the fitted temperature."""
ENOUGH = 1000
"""Query places that a temperature is fitted on; of more, so many are taken evenly."""
GRID = 24
"""Temperatures tried, evenly in their logarithm, before the best is refined."""


@short_repr
@dataclass(frozen=True, eq=False)
class Judgement:
    """Figures of one look at a part of the split.

    Args:
        loss: of all its pairs.
        pr_auc: over all its pairs; NaN where none is positive.

    """

    loss: float
    pr_auc: float


def embed(encoder: Encoder, variant: Variant) -> Tensor:
    """(P, D) embeddings of a variant's places, without gradient and in evaluation mode."""
    training = encoder.training
    encoder.eval()
    with torch.no_grad():
        z: Tensor = encoder(variant.batch)
    encoder.train(training)
    return z


def judge(encoder: Encoder, pairs: Sequence[tuple[Variant, Variant]], part: Part, config: TrainConfig) -> Judgement:
    """Score a part of the split: its places in one variant against its places in the other (paper's protocol).

    Args:
        encoder: as it is now.
        pairs: (query, map) variants of each building; places of all buildings form one map.
        part: ``validation`` or ``test``.
        config: the training's options: loss and matching radius.

    """
    z_query, z_map, queries, places = _part_embeddings(encoder, pairs, part, part)
    positive, ignore = pair_masks(queries, places, config.positive_radius_m, ignore_radius(config))
    value = float(build_loss(config)(z_query, z_map, positive, ignore))
    similarity = similarity_matrix(z_query.numpy(), z_map.numpy())
    return Judgement(loss=value, pr_auc=pr_auc(similarity, positive.numpy()))


def fit_temperature(
    encoder: Encoder, pairs: Sequence[tuple[Variant, Variant]], radius_m: float, part: Part = "validation"
) -> float:
    """Temperature at which the localiser's probability of its best place is most honest.

    For each query place of the part, p(T) is the mass of a softmax over the cosine similarities to every place of the
    map variant, within ``radius_m`` of the most similar one; the T is taken that makes the log loss of p against
    whether that place is right smallest (proper scoring; targets smoothed as Platt 1999 does).

    Args:
        encoder: trained.
        pairs: (query, map) variants of each building; places of all maps form one map.
        radius_m: the matching radius.
        part: which query places; all of them where the part has none.

    Returns:
        T within `TEMPERATURES`; 1 where there is no query place.

    """
    z_query, z_map, queries, places = _part_embeddings(encoder, pairs, part, None)
    if not len(z_query):
        z_query, z_map, queries, places = _part_embeddings(encoder, pairs, None, None)
    if not len(z_query) or not len(z_map):
        return 1.0
    taken = np.linspace(0, len(z_query) - 1, min(len(z_query), ENOUGH)).round().astype(np.int64)
    positive, _ = pair_masks(queries, places, radius_m)
    around, _ = pair_masks(places, places, radius_m)
    similarity = similarity_matrix(z_query.numpy()[taken], z_map.numpy()).astype(np.float64)
    best = similarity.argmax(axis=1)
    right = positive.numpy()[taken, best]
    return honest_temperature(similarity, around.numpy()[best], right)


def honest_temperature(similarity: Floats, near_best: Bools, right: Bools) -> float:
    """The T of `fit_temperature`.

    Args:
        similarity: (Q, M).
        near_best: (Q, M), which places lie within the matching radius of the query's most similar one.
        right: (Q,), whether that one is right.

    """
    from scipy.optimize import minimize_scalar

    def loss(log_t: float) -> float:
        return _log_loss(similarity, near_best, right, math.exp(log_t))

    # The curve may have several valleys: a grid finds the deepest, Brent's method its floor.
    grid = np.linspace(math.log(TEMPERATURES[0]), math.log(TEMPERATURES[1]), GRID)
    best = int(np.argmin([loss(log_t) for log_t in grid]))
    bounds = grid[max(0, best - 1)], grid[min(GRID - 1, best + 1)]
    found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-4})
    return float(math.exp(found.x))


def _log_loss(similarity: Floats, near_best: Bools, right: Bools, temperature: float) -> float:
    """Log loss of the probabilities at a temperature, with Platt's targets (n + 1) / (n + 2) and 1 / (n + 2)."""
    logits = (similarity - similarity.max(axis=1, keepdims=True)) / temperature
    total = np.logaddexp.reduce(logits, axis=1)
    inside = np.logaddexp.reduce(np.where(near_best, logits, -np.inf), axis=1) - total
    outside = np.logaddexp.reduce(np.where(near_best, -np.inf, logits), axis=1) - total
    n_right = int(right.sum())
    n_wrong = len(right) - n_right
    target = np.where(right, (n_right + 1) / (n_right + 2), 1 / (n_wrong + 2))
    least = math.log(1e-12)
    loss = -(target * np.maximum(inside, least) + (1 - target) * np.maximum(outside, least))
    return float(np.mean(loss))


def _part_embeddings(
    encoder: Encoder,
    pairs: Sequence[tuple[Variant, Variant]],
    query_part: Part | None,
    map_part: Part | None,
) -> tuple[Tensor, Tensor, Located, Located]:
    """Embeddings of query (B, D) and map places (M, D) of the parts (None: all), and where both are."""
    z_query: list[Tensor] = []
    z_map: list[Tensor] = []
    queries: Located = []
    places: Located = []
    for query, reference in pairs:
        for variant, part, rows, at in (
            (query, query_part, z_query, queries),
            (reference, map_part, z_map, places),
        ):
            mask = np.ones(len(variant.positions), dtype=np.bool_) if part is None else variant.mask(part)
            rows.append(embed(encoder, variant)[torch.from_numpy(mask)])
            at.append((variant.building, variant.positions[mask]))
    return torch.cat(z_query), torch.cat(z_map), queries, places
