"""Integrated Gradients: the gradient along the way from a baseline without information to the query."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from semloc_core.errors import ConfigError
from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery

Baseline = Literal["zero", "uniform", "mean"]
BASELINES: tuple[Baseline, ...] = ("zero", "uniform", "mean")


def integrated_gradients(
    query: SimilarityQuery, *, steps: int = 50, baseline: Baseline | Tensor = "zero"
) -> ObjectScores:
    """Σ_c (x_ic - x'_ic) ∫₀¹ ∂s/∂x_ic (x' + α(x - x')) dα for each object i.

    Sundararajan, Taly, Yan, "Axiomatic Attribution for Deep Networks", 2017. The integral is taken by Gauss–Legendre
    quadrature, as Captum's default; all steps are one batch. Scores sum to s(x) - s(x') but for quadrature:
    ``completeness_gap`` is what is missing, and nodes that are no objects are part of it. Objects are blanked, not
    removed: the graph stays. Where all features may be scaled without effect (counts scaled to unit length), the
    scores from a zero baseline sum to zero and the gap is the whole similarity.

    Args:
        query: what is explained.
        steps: points of the quadrature.
        baseline: ``zero``: objects of no class; ``uniform``: of each of the C classes in equal parts; ``mean``: of the
            mean class of the query's objects; or (N, C) float32.

    Raises:
        ConfigError: no step, or a baseline that is not one.

    """
    if steps < 1:
        raise ConfigError(f"expected at least one step (got {steps})")
    features = query.features
    start = _baseline(query, baseline)
    alpha, weight = _gauss_legendre(steps)
    difference = features - start
    path = start + alpha.to(features)[:, None, None] * difference
    similarity, gradient = query.of_features(torch.cat([start[None], features[None], path]))  # the two ends first
    mean = torch.einsum("k,koc->oc", weight.to(gradient.device), gradient[2:].double())
    values = (mean * difference.index_select(0, query.rows)).sum(1).cpu().numpy()
    gap = float(similarity[1] - similarity[0] - values.sum())
    return query.scores("integrated_gradients", values, completeness_gap=gap)


def _baseline(query: SimilarityQuery, baseline: Baseline | Tensor) -> Tensor:
    features, rows = query.features, query.rows
    if isinstance(baseline, Tensor):
        if baseline.shape != features.shape or baseline.dtype != features.dtype:
            expected = f"expected a {features.dtype} baseline {tuple(features.shape)}"
            raise ConfigError(f"{expected} (got {baseline.dtype} {tuple(baseline.shape)})")
        return baseline
    if baseline not in BASELINES:
        raise ConfigError(f"expected a baseline among {', '.join(BASELINES)} (got {baseline!r})")
    start = torch.zeros_like(features)
    if baseline == "uniform":
        start[rows] = 1.0 / features.shape[1]
    elif baseline == "mean" and len(rows):
        start[rows] = features[rows].mean(0)
    return start


@lru_cache(maxsize=16)
def _gauss_legendre(steps: int) -> tuple[Tensor, Tensor]:
    """Points in (0, 1) and weights that sum to 1, both (steps,) float64."""
    points, weights = np.polynomial.legendre.leggauss(steps)
    with torch.inference_mode(False):
        return torch.from_numpy((1.0 + points) / 2.0), torch.from_numpy(weights / 2.0)
