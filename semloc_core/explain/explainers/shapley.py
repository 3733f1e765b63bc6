"""Shapley values of objects and of classes: what each adds when it joins, the others there or not.

A player that is absent is removed from the graph, not blanked. The value of a coalition is the similarity; scores sum
to the query's similarity less that of the same places without any object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.explain.explainers.coalitions import ShapleyValues, exact_values, sampled_values
from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery

PERMUTATIONS = 25
"""Captum's default number of samples."""
MAX_EXACT_CLASSES = 12
CLASS_PERMUTATIONS = 200
"""Orders drawn where there are more classes: about what 12 classes cost exactly (200 · 13 coalitions of 4096)."""


def shapley_sampling(
    query: SimilarityQuery, rng: np.random.Generator, *, permutations: int = PERMUTATIONS
) -> ObjectScores:
    """Shapley value sampling over objects (Štrumbelj and Kononenko 2010), with the standard error of each score.

    Args:
        query: what is explained.
        rng: draws the permutations.
        permutations: how many, at least 2.

    Raises:
        ConfigError: fewer than two permutations.

    """
    found = sampled_values(query.of_objects, query.n_objects, permutations, rng)
    return query.scores("shapley_sampling", found.values, found.standard_error, found.gap)


def class_values(
    query: SimilarityQuery, rng: np.random.Generator, *, permutations: int = CLASS_PERMUTATIONS
) -> ShapleyValues:
    """Shapley values of the classes present, in the order of ``query.class_players``.

    A class joins with all its objects. Exact up to `MAX_EXACT_CLASSES` classes, sampled past that.

    Args:
        query: what is explained.
        rng: draws the permutations where there are any.
        permutations: how many are drawn past `MAX_EXACT_CLASSES` classes.

    """
    names, players = query.class_players

    def game(present: NDArray[np.bool_]) -> NDArray[np.float64]:
        return query.of_objects(present[:, players])

    if len(names) <= MAX_EXACT_CLASSES:
        return exact_values(game, len(names))
    return sampled_values(game, len(names), permutations, rng)


def class_shapley(
    query: SimilarityQuery, rng: np.random.Generator, *, permutations: int = CLASS_PERMUTATIONS
) -> ObjectScores:
    """Shapley values of classes, each spread evenly over the class's objects: the players say nothing of one object.

    So sums by class (`semloc_core.explain.class_scores`) are the classes' Shapley values, and so are sums of standard
    errors. Arguments as of `class_values`.
    """
    found = class_values(query, rng, permutations=permutations)
    names, players = query.class_players
    share = 1.0 / np.bincount(players, minlength=len(names))[players]
    error = found.standard_error[players] * share if found.standard_error is not None else None
    return query.scores("class_shapley", found.values[players] * share, error, found.gap)
