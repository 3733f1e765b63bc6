"""The validation split: how good the encoder is on places it was not trained on, and the temperature it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from semloc_core.encoder.base import Encoder
from semloc_core.evaluate.metrics import pr_auc, similarity_matrix
from semloc_core.graph_arrays import Floats
from semloc_core.training.config import TrainConfig
from semloc_core.training.losses import build_loss, ignore_radius
from semloc_core.training.split import Bools, Part
from semloc_core.training.variants import Variant, pair_masks

Located = list[tuple[int, Floats]]
"""Blocks of rows: the building they are in, and (b, 3) positions in metres."""
TEMPERATURES = (1e-4, 10.0)
"""Bounds of the fitted temperature."""
GRID = 24
"""Temperatures tried, evenly in their logarithm, before the best is refined."""


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


def judge(
    encoder: Encoder, pairs: Sequence[tuple[Variant, Variant]], part: Part, config: TrainConfig
) -> Judgement:
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
    """Temperature of the softmax over all places of the map that makes the right ones likeliest.

    Minimises the mean over the part's query places of −log Σ_{m positive} softmax_m(s_m / T), s the cosine
    similarities to every place of the other variant: that is what the localiser sums to a probability.

    Args:
        encoder: trained.
        pairs: (query, map) variants of each building.
        radius_m: the matching radius.
        part: which query places; all of them where the part has none with a positive.

    Returns:
        T within `TEMPERATURES`; 1 where no place has a positive.

    """
    z_query, z_map, queries, places = _part_embeddings(encoder, pairs, part, None)
    positive, _ = pair_masks(queries, places, radius_m)
    if not positive.any():
        z_query, z_map, queries, places = _part_embeddings(encoder, pairs, None, None)
        positive, _ = pair_masks(queries, places, radius_m)
    similarity = similarity_matrix(z_query.numpy(), z_map.numpy()).astype(np.float64)
    return likeliest_temperature(similarity, positive.numpy())


def likeliest_temperature(similarity: Floats, positive: Bools) -> float:
    """The T of `fit_temperature`, from similarities (Q, M) and which of them are right (Q, M)."""
    from scipy.optimize import minimize_scalar

    judged = positive.any(axis=1)
    if not judged.any():
        return 1.0
    similarity, positive = similarity[judged], positive[judged]

    def surprise(log_t: float) -> float:
        return _surprise(similarity, positive, math.exp(log_t))

    # The curve may have several valleys: a grid finds the deepest, Brent's method its floor.
    grid = np.linspace(math.log(TEMPERATURES[0]), math.log(TEMPERATURES[1]), GRID)
    best = int(np.argmin([surprise(log_t) for log_t in grid]))
    bounds = grid[max(0, best - 1)], grid[min(GRID - 1, best + 1)]
    found = minimize_scalar(surprise, bounds=bounds, method="bounded", options={"xatol": 1e-4})
    return float(math.exp(found.x))


def _surprise(similarity: Floats, positive: Bools, temperature: float) -> float:
    """Mean of −log of the softmax's mass on the positives."""
    logits = (similarity - similarity.max(axis=1, keepdims=True)) / temperature
    total = np.logaddexp.reduce(logits, axis=1)
    right = np.logaddexp.reduce(np.where(positive, logits, -np.inf), axis=1)
    return float(np.mean(total - right))


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
