"""The paper's study of explanations on one graph: ablation, importance, shift, fidelity, agreement, hypotheses."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.introspection.agreement.ranks import spearman
    from semloc_core.introspection.agreement.rows import ALL_EXPLAINERS, correlation
    from semloc_core.introspection.checks import check_lines
    from semloc_core.introspection.hypotheses import most_faithful, overall
    from semloc_core.introspection.mobility_study import MOVED_M
    from semloc_core.introspection.rows import ranking_rows
    from semloc_core.introspection.run import ABLATION, Run
    from semloc_core.introspection.sanity import mean_rows
    from semloc_core.introspection.study import Introspection, introspect
    from semloc_core.introspection.views import Matrices, matrices, plan_parts, similarity_to_map, typical_query
    from semloc_core.introspection.whole_map import INVERTED
else:
    __getattr__ = exports(__name__)

__all__ = [
    "ABLATION", "ALL_EXPLAINERS", "INVERTED", "Introspection", "MOVED_M", "Matrices", "Run", "check_lines",
    "correlation", "introspect", "matrices", "mean_rows", "most_faithful", "overall", "plan_parts", "ranking_rows",
    "similarity_to_map", "spearman", "typical_query",
]  # fmt: skip
