"""Figures and the HTML page: what was measured elsewhere, drawn. Nothing here is imported by the node."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.report.drawing import to_png
    from semloc_core.report.floor_plan import Plan
    from semloc_core.report.growth_figure import growth_picture
    from semloc_core.report.introspection.page import introspection_page
    from semloc_core.report.kept_page import keep, kept
    from semloc_core.report.replay.data import has_answers, read_results
    from semloc_core.report.replay.gathering import ReplayData
    from semloc_core.report.replay.live import Feed, served
    from semloc_core.report.replay.page import live_page, replay_page
    from semloc_core.report.replay.picture import answer_picture
    from semloc_core.report.trust_figures import failure_figure, reliability_figure, success_figure
    from semloc_core.report.update_figure import update_picture
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Feed", "Plan", "ReplayData", "answer_picture", "failure_figure", "growth_picture", "has_answers",
    "introspection_page", "keep", "kept", "live_page", "read_results", "reliability_figure", "replay_page", "served",
    "success_figure", "to_png", "update_picture",
]  # fmt: skip
