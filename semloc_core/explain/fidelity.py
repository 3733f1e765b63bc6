"""Fidelity: whether the similarity rests on the objects that an explainer puts first.

The paper's necessity Δ⁺, sufficiency Δ⁻ and characterisation score (Section V, after Pope et al. 2019 and Amara et al.
2022), on similarity in place of a predicted probability. Embeddings are unit vectors, so the scalar product s lies in
[-1, 1]; here it is (1 + s)/2, which keeps Δ⁺, Δ⁻ and 1 - Δ⁻ in [0, 1] and the characterisation score defined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import ConfigError
from semloc_core.explain.scores import ObjectScores, class_scores, object_scores
from semloc_core.explain.similarity import SimilarityQuery
from semloc_core.graph import Floats
from semloc_core.text import short_repr
from semloc_core.wire import Fidelity, MethodAttributions

BUDGET = 0.3
"""ρ⋆, the fixed budget of what is published; the paper gives none."""
BUDGETS = tuple(round(0.1 * i, 1) for i in range(1, 11))


@short_repr
@dataclass(frozen=True, eq=False)
class FidelityCurve:
    """One explainer's fidelity on one query.

    Args:
        method: the explainer's name.
        budgets: (R,) fraction of the objects kept, or dropped.
        necessity: (R,) Δ⁺ = |s_drop - s_full|.
        sufficiency: (R,) Δ⁻ = |s_full - s_keep|; small is good.
        characterisation: (R,) weighted harmonic mean of Δ⁺ and 1 - Δ⁻.

    """

    method: str
    budgets: Floats
    necessity: Floats
    sufficiency: Floats
    characterisation: Floats


def budget_count(budget: float, n_objects: int) -> int:
    """How many objects a budget is: ⌈ρ·O⌉. Of the graph's nodes only objects count; places always stay."""
    return min(n_objects, math.ceil(budget * n_objects - 1e-9))  # 0.7 · 10 is a little more than 7


def ranking(scores: ObjectScores) -> NDArray[np.int64]:
    """(O,) objects by falling score, ties by id."""
    order = sorted(range(len(scores.ids)), key=lambda i: (-float(scores.scores[i]), scores.ids[i]))
    return np.array(order, dtype=np.int64)


def characterisation(necessity: Floats, sufficiency: Floats, w_plus: float = 0.5, w_minus: float = 0.5) -> Floats:
    """(w₊ + w₋) / (w₊/Δ⁺ + w₋/(1 - Δ⁻)): the paper's equation.

    Where a term that has weight is zero (nothing changed on dropping; everything changed on keeping), the harmonic
    mean tends to 0 and is 0 here. A term without weight has no say.

    Args:
        necessity: Δ⁺, in [0, 1].
        sufficiency: Δ⁻, in [0, 1].
        w_plus: weight of necessity, in [0, 1].
        w_minus: weight of sufficiency, in [0, 1]; the two sum to 1.

    Raises:
        ConfigError: weights out of range, or that do not sum to 1.

    """
    if not (0 <= w_plus <= 1 and 0 <= w_minus <= 1 and math.isclose(w_plus + w_minus, 1)):
        raise ConfigError(f"expected weights in [0, 1] that sum to 1 (got {w_plus} and {w_minus})")
    weighted = [(w, x) for w, x in ((w_plus, necessity), (w_minus, 1.0 - sufficiency)) if w > 0]
    total = np.zeros_like(necessity)
    defined = np.ones(necessity.shape, dtype=np.bool_)
    for weight, term in weighted:
        defined &= term > 0
        total += weight / np.where(term > 0, term, 1.0)
    return np.where(defined, (w_plus + w_minus) / total, 0.0)


def fidelity_curves(
    query: SimilarityQuery, scores: Sequence[ObjectScores], budgets: Sequence[float] = BUDGETS
) -> list[FidelityCurve]:
    """Fidelity of several explainers over a grid of budgets, all in one batch.

    Args:
        query: what was explained.
        scores: of each explainer, on this query.
        budgets: R fractions ρ in [0, 1].

    Raises:
        ConfigError: a budget out of range, or scores of other objects.

    """
    for budget in budgets:
        if not 0 <= budget <= 1:
            raise ConfigError(f"expected budgets in [0, 1] (got {budget})")
    counts = [budget_count(budget, query.n_objects) for budget in budgets]
    top = np.zeros((len(scores), len(counts), query.n_objects), dtype=np.bool_)
    for method, of in enumerate(scores):
        if of.ids != query.ids:
            raise ConfigError(f"expected scores of the query's {query.n_objects} objects (got {len(of.ids)} others)")
        order = ranking(of)
        for i, count in enumerate(counts):
            top[method, i, order[:count]] = True
    flat = top.reshape(-1, query.n_objects)
    value = _to_unit(query.of_objects(np.concatenate([flat, ~flat])))
    keep, drop = value.reshape(2, len(scores), len(counts))
    full = _to_unit(np.array(query.full))
    necessity, sufficiency = np.abs(drop - full), np.abs(full - keep)
    score = characterisation(necessity, sufficiency)
    return [
        FidelityCurve(of.method, np.array(budgets, dtype=np.float64), necessity[m], sufficiency[m], score[m])
        for m, of in enumerate(scores)
    ]


def own_fidelity(query: SimilarityQuery, scores: ObjectScores, budget: float = BUDGET) -> Fidelity:
    """What a published attribution says of itself: fidelity at one budget, for two encodings in one batch.

    Args:
        query: what was explained; where it knows its own similarity, nothing more is encoded.
        scores: the attribution.
        budget: ρ⋆.

    """
    (curve,) = fidelity_curves(query, [scores], [budget])
    return Fidelity(
        necessity=float(curve.necessity[0]),
        sufficiency=float(curve.sufficiency[0]),
        characterisation=float(curve.characterisation[0]),
        budget=budget,
    )


def said_by(query: SimilarityQuery, scores: ObjectScores) -> MethodAttributions:
    """What is published of an explainer's scores: by class and by object, and how well that holds when tested."""
    return MethodAttributions(
        method=scores.method,
        classes=class_scores(scores),
        objects=object_scores(scores),
        fidelity=own_fidelity(query, scores),
        completeness_gap=scores.completeness_gap,
    )


def _to_unit(similarity: Floats) -> Floats:
    """(1 + s)/2 in [0, 1], also where rounding left s a little outside of [-1, 1]."""
    return np.clip((1.0 + similarity) / 2.0, 0.0, 1.0)
