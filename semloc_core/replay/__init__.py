"""Replay: a recorded run through the localiser, without ROS, and how right its answers were."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.replay.recorded import (
        ATTRIBUTIONS_TOPIC,
        MATCHES_TOPIC,
        Answer,
        ReplaySummary,
        Scored,
        replay,
        score_results,
    )
    from semloc_core.replay.traversal_score import FROM_METRES, LatencyHistogram, TraversalScore
else:
    __getattr__ = exports(__name__)

__all__ = [
    "ATTRIBUTIONS_TOPIC", "Answer", "FROM_METRES", "LatencyHistogram", "MATCHES_TOPIC", "ReplaySummary", "Scored",
    "TraversalScore", "replay", "score_results",
]  # fmt: skip
