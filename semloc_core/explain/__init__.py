"""Why a place matched: one explainer a file, all of them answering with `ObjectScores`.

`semloc_core.explain.similarity` is what they ask, `semloc_core.explain.explainers.by_name` lists them by name.
"""

from semloc_core.explain.scores import ObjectScores, class_scores, object_scores
from semloc_core.explain.similarity import SimilarityQuery

__all__ = ["ObjectScores", "SimilarityQuery", "class_scores", "object_scores"]
