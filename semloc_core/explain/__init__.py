"""Why a place matched: one explainer a file, all of them answering with `ObjectScores`."""

from semloc_core.explain.scores import ObjectScores, class_scores, object_scores

__all__ = ["ObjectScores", "class_scores", "object_scores"]
