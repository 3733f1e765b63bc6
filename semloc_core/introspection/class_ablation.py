"""What becomes of localisation and of importance when all objects of one class are gone (paper, Section V)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.graph import Floats, GraphArrays, Labelspace
from semloc_core.training import positive_pairs

Bools = NDArray[np.bool_]


def class_frequencies(arrays: GraphArrays, labelspace: Labelspace) -> dict[str, float]:
    """Class -> its part of the objects, by name; classes that the building lacks are left out."""
    known = arrays.object_classes[arrays.object_classes >= 0]
    counts = np.bincount(known, minlength=len(labelspace))
    return {
        labelspace.classes[c]: float(counts[c]) / len(known)
        for c in sorted(np.flatnonzero(counts).tolist(), key=lambda c: labelspace.classes[c])
    }


def without_class(arrays: GraphArrays, labelspace: Labelspace, name: str) -> GraphArrays:
    """The building with every instance of a class removed."""
    return arrays.with_objects(arrays.object_classes != labelspace.index(name))


def ablate_classes(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    *,
    query_rows: Bools | None = None,
    map_rows: Bools | None = None,
    radius_m: float = 4.0,
) -> dict[str, float]:
    """Loss of PR-AUC when a class is removed from query and map, without training anew.

    Args:
        model: the model.
        query: the query graph.
        reference: the map's graph.
        query_rows: (P,) which query places are judged; None: all.
        map_rows: (P,) which map places are the database; None: all.
        radius_m: map places within this distance of the query are positives.

    Returns:
        Class -> PR-AUC with it minus PR-AUC without it; positive where the class helps. Divide by
        `class_frequencies` for the paper's figure.

    """
    positive = positive_pairs(query.place_positions, reference.place_positions, radius_m)
    asked = np.ones(query.n_places, dtype=np.bool_) if query_rows is None else query_rows
    known = np.ones(reference.n_places, dtype=np.bool_) if map_rows is None else map_rows

    def judge(a: GraphArrays, b: GraphArrays) -> float:
        similarity = similarity_matrix(embed_graph(model, a)[asked], embed_graph(model, b)[known])
        return metrics.pr_auc(similarity, positive[np.ix_(asked, known)])

    space = model.labelspace
    whole = judge(query, reference)
    return {
        name: whole - judge(without_class(query, space, name), without_class(reference, space, name))
        for name in class_frequencies(reference, space)
    }


def importance_shift(before: Floats, after: Floats, over: Bools | None = None) -> float:
    """Jensen–Shannon divergence, in bits, between two distributions of importance over the same objects.

    Args:
        before: (O,) ≥ 0, with the class.
        after: (O,) ≥ 0, without it: zero for its objects.
        over: (O,) which objects are compared; None: all, as the paper's words have it. Then what the class itself
            lost counts too; over the remaining ones only, it is how the rest was weighted anew.

    Returns:
        In [0, 1]; NaN where one of the two has no importance at all.

    """
    from scipy.spatial.distance import jensenshannon

    if over is not None:
        before, after = before[over], after[over]
    if before.sum() <= 0 or after.sum() <= 0:
        return float("nan")
    return float(jensenshannon(before, after, base=2) ** 2)


def spread(values: Floats, ids: Sequence[str], onto: Sequence[str]) -> Floats:
    """Values of some objects laid out over more of them; zero for those not there."""
    row = {id_: i for i, id_ in enumerate(onto)}
    out = np.zeros(len(onto))
    out[[row[id_] for id_ in ids]] = values
    return out
