"""What a run's pictures show: place–query matrices, and the similarity of all places to one query."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import Model, build_encoder, embed_graph, similarity_matrix
from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.introspection.run import Run
from semloc_core.text import short_repr
from semloc_core.training import positive_pairs


@short_repr
@dataclass(frozen=True, eq=False)
class Matrices:
    """Place–query matrices of the held-out places: truth, bag of words, model.

    Args:
        places: (Q,) which places, neighbours beside each other.
        truth: (Q, Q) bool, which map place (column) is right for a query (row).
        similarity: (``bag_of_words``, the model's encoder) -> (Q, Q) cosine similarity.
        pr_auc: the same names -> PR-AUC.

    """

    places: Ints
    truth: NDArray[np.bool_]
    similarity: dict[str, NDArray[np.float32]]
    pr_auc: dict[str, float]


def matrices(run: Run) -> Matrices:
    """The paper's three matrices, on the places that PR-AUC is taken over."""
    judged = np.flatnonzero(run.judged)
    places = judged[neighbours_together(run.reference.place_positions[judged])]
    at = run.query.place_positions[places], run.reference.place_positions[places]
    truth = positive_pairs(*at, MATCH_RADIUS_M)
    space = run.model.labelspace
    models = {
        "bag_of_words": Model(build_encoder("bag_of_words", None, len(space)).eval(), space),
        run.model.encoder.name: run.model,
    }
    similarity = {
        name: similarity_matrix(embed_graph(m, run.query)[places], embed_graph(m, run.reference)[places])
        for name, m in models.items()
    }
    return Matrices(
        places, truth, similarity, {name: metrics.pr_auc(matrix, truth) for name, matrix in similarity.items()}
    )


def neighbours_together(positions: Floats) -> Ints:
    """An order of points in which those near each other in space are near in the order (a dendrogram's leaves)."""
    from scipy.cluster.hierarchy import leaves_list, linkage

    if len(positions) < 3:
        return np.arange(len(positions))
    order: Ints = leaves_list(linkage(positions, "average", optimal_ordering=len(positions) <= 1000)).astype(np.int64)
    return order


def similarity_to_map(run: Run, place: int) -> Floats:
    """(P,) cosine similarity of every map place to one query place."""
    z = embed_graph(run.model, run.query)[place]
    found: Floats = (embed_graph(run.model, run.reference) @ z).astype(np.float64)
    return found


def typical_query(run: Run) -> int:
    """The explained place that sees the most objects: of the picture, not of any figure; the first if several do."""
    return int(run.introspection.places[int(run.introspection.seen.sum(1).argmax())])


def plan_parts(arrays: GraphArrays) -> tuple[Floats, Floats]:
    """(P, 2) places and (E, 2, 2) both ends of each edge, for a floor plan."""
    at = arrays.place_positions[:, :2]
    return at, at[arrays.place_edges.T]
