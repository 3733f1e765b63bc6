"""Why a place matched: one explainer a file, all of them answering with `ObjectScores`.

`semloc_core.explain.similarity` is what they ask, `semloc_core.explain.explainers.by_name` lists them by name.
"""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.explain.attributions import EXPLAINER_SEED, answer_evidence, due, explain_answer
    from semloc_core.explain.class_shift import ClassShift, Shift
    from semloc_core.explain.explainers.by_name import CONTROLS, EXPLAINERS, check_methods, explain
    from semloc_core.explain.explainers.integrated_gradients import BASELINES, integrated_gradients
    from semloc_core.explain.explainers.random_baseline import inverted
    from semloc_core.explain.explainers.shapley import class_shapley
    from semloc_core.explain.fidelity import BUDGET, BUDGETS, FidelityCurve, fidelity_curves
    from semloc_core.explain.layout_scores import LAYOUT
    from semloc_core.explain.pair import answer_query, asked_methods, check_asked, explain_pair, find_row
    from semloc_core.explain.scores import ObjectScores, class_scores, object_scores
    from semloc_core.explain.similarity import SimilarityQuery
else:
    __getattr__ = exports(__name__)

__all__ = [
    "BASELINES", "BUDGET", "BUDGETS", "CONTROLS", "ClassShift", "EXPLAINERS", "EXPLAINER_SEED", "FidelityCurve",
    "LAYOUT", "ObjectScores", "Shift", "SimilarityQuery", "answer_evidence", "answer_query", "asked_methods",
    "check_asked", "check_methods", "class_scores", "class_shapley", "due", "explain", "explain_answer",
    "explain_pair", "fidelity_curves", "find_row", "integrated_gradients", "inverted", "object_scores",
]  # fmt: skip
