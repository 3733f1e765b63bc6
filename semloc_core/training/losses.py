r"""The paper's three losses, multi-positive (section IV-B2, Table II).

All take z_query (B, D) and z_map (M, D), float32 rows of unit length; ``positive`` (B, M) bool, which map places are
the query's place (within 4 m of the truth); ``ignore`` (B, M) bool or None, pairs that are neither. They return a
scalar, the mean over the queries that can be judged, and a zero with a gradient of zero where none can. Below, an
``Args`` names only what a loss takes besides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from semloc_core.training.config import TrainConfig

Loss = Callable[[Tensor, Tensor, Tensor, Tensor | None], Tensor]


def contrastive(
    z_query: Tensor, z_map: Tensor, positive: Tensor, ignore: Tensor | None = None, *, margin: float = 1.0
) -> Tensor:
    r"""Contrastive loss (Hadsell, Chopra, LeCun 2006, equation 4; paper: margin 1).

    With d the Euclidean distance of a pair, a positive pair costs d²/2 and a negative one max(0, margin − d)²/2.
    The two kinds are averaged apart and added: else the negatives, many times more, would drown the positives.

    Args:
        margin: distance beyond which a negative pair costs nothing.

    """
    negative = _negative(positive, ignore)
    squared = _squared_distance(z_query, z_map)
    attract = squared / 2
    repel = (margin - _root(squared)).clamp(min=0).square() / 2
    return _mean(attract, _positive(positive, ignore)) + _mean(repel, negative)


def triplet(
    z_query: Tensor,
    z_map: Tensor,
    positive: Tensor,
    ignore: Tensor | None = None,
    *,
    margin: float = 0.2,
    mining: Literal["hard_negative", "batch_hard"] = "hard_negative",
) -> Tensor:
    r"""Triplet loss with hard mining (Weinberger, Saul 2009, equation 13, on the hardest impostor).

    With d the Euclidean distance and n the nearest negative: max(0, margin + d_p − d_n), averaged over the positives
    p of a query and over queries. ``batch_hard`` (Hermans, Beyer, Leibe 2017, equation 5) takes only the farthest
    positive; where places within 4 m may lie in two rooms that one is often hopeless, and all embeddings collapse
    into one. Pairs just beyond the matching radius are best ignored: their places are all but the same. A query
    without a positive or a negative is left out.

    Args:
        margin: by how much the negative must be farther.
        mining: which positives.

    """
    positive, negative = _positive(positive, ignore), _negative(positive, ignore)
    judged = positive.any(1) & negative.any(1)
    if not judged.any():
        return _nothing(z_query, z_map)
    distance, chosen = _root(_squared_distance(z_query, z_map))[judged], positive[judged]
    nearest = distance.masked_fill(~negative[judged], torch.inf).amin(1)
    if mining == "batch_hard":
        farthest = distance.masked_fill(~chosen, -torch.inf).amax(1)
        return (margin + farthest - nearest).clamp(min=0).mean()
    violation = (margin + distance - nearest[:, None]).clamp(min=0).masked_fill(~chosen, 0.0)
    return (violation.sum(1) / chosen.sum(1)).mean()


def infonce(
    z_query: Tensor, z_map: Tensor, positive: Tensor, ignore: Tensor | None = None, *, temperature: float = 0.7
) -> Tensor:
    r"""InfoNCE (van den Oord, Li, Vinyals 2018, equation 4; paper: T = 0.7) with several positives.

    Each positive p is told from all map places m that are not ignored, and the positives of a query are averaged
    (Khosla et al. 2020, equation 2): −mean_p [s_p / T − log Σ_m exp(s_m / T)], s the scalar product. A query without
    a positive is left out.
    """
    return _told_apart(
        z_query, z_map, positive, ignore, temperature,
        lambda logits, chosen: logits.masked_fill(~chosen, 0.0).sum(1) / chosen.sum(1),
    )  # fmt: skip


def mil_nce(
    z_query: Tensor, z_map: Tensor, positive: Tensor, ignore: Tensor | None = None, *, temperature: float = 0.07
) -> Tensor:
    r"""MIL-NCE (Miech et al., CVPR 2020, equation 1): InfoNCE content with any of the positives.

    −log [Σ_p exp(s_p / T) / Σ_m exp(s_m / T)]: one answer that is right is enough, places within the matching radius
    need not look alike. A query without a positive is left out.
    """
    return _told_apart(
        z_query, z_map, positive, ignore, temperature,
        lambda logits, chosen: logits.masked_fill(~chosen, -torch.inf).logsumexp(1),
    )  # fmt: skip


def ignore_radius(config: TrainConfig) -> float:
    """Distance (m) up to which a pair that is not positive is no negative either."""
    return config.positive_radius_m + (config.triplet_gap_m if config.loss == "triplet" else 0.0)


def build_loss(config: TrainConfig) -> Loss:
    """The loss that a training configuration names, with its margin or temperature."""

    def loss(z_query: Tensor, z_map: Tensor, positive: Tensor, ignore: Tensor | None) -> Tensor:
        if config.loss == "contrastive":
            return contrastive(z_query, z_map, positive, ignore, margin=config.margin)
        if config.loss == "triplet":
            margin, mining = config.triplet_margin, config.triplet_mining
            return triplet(z_query, z_map, positive, ignore, margin=margin, mining=mining)
        if config.loss == "mil_nce":
            return mil_nce(z_query, z_map, positive, ignore, temperature=config.temperature)
        return infonce(z_query, z_map, positive, ignore, temperature=config.temperature)

    return loss


def _positive(positive: Tensor, ignore: Tensor | None) -> Tensor:
    return positive if ignore is None else positive & ~ignore


def _told_apart(
    z_query: Tensor, z_map: Tensor, positive: Tensor, ignore: Tensor | None, temperature: float,
    of_positives: Callable[[Tensor, Tensor], Tensor],
) -> Tensor:  # fmt: skip
    """Log Σ_m exp(s_m / T) over what is not ignored, less what (logits, positives) say of the positives: the mean."""
    positive = _positive(positive, ignore)
    judged = positive.any(1)
    if not judged.any():
        return _nothing(z_query, z_map)
    logits = (z_query @ z_map.T)[judged] / temperature
    if ignore is not None:
        logits = logits.masked_fill(ignore[judged], -torch.inf)
    return (logits.logsumexp(1) - of_positives(logits, positive[judged])).mean()


def _negative(positive: Tensor, ignore: Tensor | None) -> Tensor:
    return ~positive if ignore is None else ~(positive | ignore)


def _squared_distance(z_query: Tensor, z_map: Tensor) -> Tensor:
    """(B, M) squared Euclidean distances; exact for rows of any length (a place in view of nothing embeds to zero)."""
    product = z_query @ z_map.T
    return (z_query.square().sum(1)[:, None] + z_map.square().sum(1)[None, :] - 2 * product).clamp(min=0)


def _root(squared: Tensor) -> Tensor:
    """Square root whose gradient at zero is zero instead of infinite: two equal embeddings have no direction."""
    apart = squared > 0
    return torch.where(apart, torch.where(apart, squared, 1.0).sqrt(), 0.0)


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return (values * where).sum() / where.sum().clamp(min=1)


def _nothing(z_query: Tensor, z_map: Tensor) -> Tensor:
    return 0.0 * (z_query.sum() + z_map.sum())
