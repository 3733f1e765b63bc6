"""Controls: explainers that know nothing, or the wrong thing. One that does not beat them explains nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery


def random_scores(query: SimilarityQuery, rng: np.random.Generator) -> ObjectScores:
    """Scores drawn uniformly from [0, 1): a random ranking."""
    return query.scores("random", rng.random(query.n_objects))


def inverted(scores: ObjectScores) -> ObjectScores:
    """The same scores with the sign turned: what was least important comes first."""
    return replace(
        scores,
        method=f"inverted_{scores.method}",
        scores=-scores.scores,
        completeness_gap=None,
        unattributed=None,
    )
