"""Explainers by name, each a function from a query to object scores."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from semloc_core.errors import ConfigError, ModelError
from semloc_core.explain.explainers.integrated_gradients import integrated_gradients
from semloc_core.explain.explainers.random_baseline import random_scores
from semloc_core.explain.explainers.saliency import saliency
from semloc_core.explain.explainers.shapley import class_shapley, shapley_sampling
from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery

Explainer = Callable[[SimilarityQuery, np.random.Generator], ObjectScores]


def attention(query: SimilarityQuery) -> ObjectScores:
    """What the model itself says (`semloc_core.explain.intrinsic`): its attention, where it has any.

    Raises:
        ModelError: a model from elsewhere, of which only its similarity is known.

    """
    if query.intrinsic is None:
        raise ModelError("expected a model that says what it attends to (got a bare similarity)")
    return query.intrinsic()


EXPLAINERS: dict[str, Explainer] = {
    "saliency": lambda query, rng: saliency(query),
    "integrated_gradients": lambda query, rng: integrated_gradients(query),
    "shapley_sampling": shapley_sampling,
    "class_shapley": class_shapley,
    "attention": lambda query, rng: attention(query),
}
"""In the paper's order; class Shapley is what the paper lacks."""

CONTROLS: dict[str, Explainer] = {"random": random_scores}


def explain(query: SimilarityQuery, method: str, rng: np.random.Generator) -> ObjectScores:
    """Explain by name, with the defaults.

    Args:
        query: what is explained.
        method: a key of `EXPLAINERS` or `CONTROLS`.
        rng: for those that sample.

    Raises:
        ConfigError: no such explainer.

    """
    check_methods([method])
    return (EXPLAINERS | CONTROLS)[method](query, rng)


def check_methods(methods: Sequence[str], known: Collection[str] | None = None) -> None:
    """Raise ConfigError where a name is not among those known; None: the explainers' and the controls'."""
    known = EXPLAINERS | CONTROLS if known is None else known
    for method in methods:
        if method not in known:
            raise ConfigError(f"expected explainers among {', '.join(known)} (got {method!r})")
