"""Saliency: how steeply the similarity changes with an object's features."""

from __future__ import annotations

from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery


def saliency(query: SimilarityQuery, *, own_class: bool = False) -> ObjectScores:
    """Magnitude of the gradient of the similarity by each object's features.

    Simonyan, Vedaldi, Zisserman, "Deep Inside Convolutional Networks", 2014. As Captum's ``Saliency`` the absolute
    gradient; an object's score is its sum over all C features, as PyG adds up a node's attributes. That also
    counts how much the object *would* matter if it were of another class.

    Args:
        query: what is explained.
        own_class: count only features that the object has (for a one-hot, that of its class).

    Returns:
        Scores ≥ 0; they do not add up to anything.

    """
    _, gradient = query.of_features(query.features[None])
    magnitude = gradient[0].abs().double()
    if own_class:
        magnitude = magnitude * (query.features.index_select(0, query.rows) != 0)
    return query.scores("saliency", magnitude.sum(1).cpu().numpy())
