"""What is measured and how it is shown: retrieval and classification, honesty, intervals; rows and tables of them."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.metrics.calibration import BINS, accepted_share, expected_calibration_error
    from semloc_core.metrics.intervals import Statistic, bootstrap, squares
    from semloc_core.metrics.pivot import Pivot, online_pivots, shortlist_pivots, update_pivots
    from semloc_core.metrics.pose_error import Histogram, PoseErrors
    from semloc_core.metrics.precision_recall import (
        RANKS,
        bootstrap_interval,
        f1_at,
        fit_threshold,
        mean_and_deviation,
        pr_auc,
        retrieval,
        success_figures,
        top,
        with_interval,
    )
    from semloc_core.metrics.rows import Progress, Row, no_progress
    from semloc_core.metrics.table import HIGH, LOW, STD, cell, columns, document, print_table
    from semloc_core.metrics.weighted_precision import WeightedPrecision
else:
    __getattr__ = exports(__name__)

__all__ = [
    "BINS", "HIGH", "Histogram", "LOW", "Pivot", "PoseErrors", "Progress", "RANKS", "Row", "STD",
    "Statistic", "WeightedPrecision", "accepted_share", "bootstrap", "bootstrap_interval", "cell", "columns",
    "document", "expected_calibration_error", "f1_at", "fit_threshold", "mean_and_deviation", "no_progress",
    "online_pivots", "pr_auc", "print_table", "retrieval", "shortlist_pivots", "squares", "success_figures", "top",
    "update_pivots", "with_interval",
]  # fmt: skip
