"""From candidates to an answer: how likely each place is, and whether objects lie around the robot as they do there."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.matching.answer import Localisation, Located, Reply, ServerState, matches_of
    from semloc_core.matching.layout.answers import FEATURES, Answers, Calibration, near_figures
    from semloc_core.matching.layout.building.layout import LayoutPart
    from semloc_core.matching.layout.confidence import (
        MOST_SURE,
        SHARPNESS,
        Confidence,
        Tested,
        confidence,
        features,
        other_figures,
        perfect,
    )
    from semloc_core.matching.layout.config import LayoutConfig
    from semloc_core.matching.layout.evidence import Evidence, evidence_at
    from semloc_core.matching.layout.fragment import Fragment, fragment_of_arrays, fragment_of_graph
    from semloc_core.matching.layout.pose.placed import Placed, placed
    from semloc_core.matching.layout.verifier import LayoutVerifier, Verified
    from semloc_core.matching.posterior import (
        Ranking,
        Similarities,
        modes,
        most_similar,
        place_probabilities,
        status_of,
    )
    from semloc_core.matching.radius_index import RadiusIndex
    from semloc_core.matching.reranker import Reranked, Reranker, layout_part, share_verifier, verifier_of
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Answers", "Calibration", "Confidence", "Evidence", "FEATURES", "Fragment", "LayoutConfig", "LayoutPart",
    "LayoutVerifier", "Localisation", "Located", "MOST_SURE", "Placed", "RadiusIndex", "Ranking", "Reply", "Reranked",
    "Reranker", "SHARPNESS", "ServerState", "Similarities", "Tested", "Verified", "confidence", "evidence_at",
    "features", "fragment_of_arrays", "fragment_of_graph", "layout_part", "matches_of", "modes", "most_similar",
    "near_figures", "other_figures", "perfect", "place_probabilities", "placed", "share_verifier", "status_of",
    "verifier_of",
]  # fmt: skip
