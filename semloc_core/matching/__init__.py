"""From candidates to an answer: how likely each place is, and whether objects lie around the robot as they do there."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.matching.answer import Localisation, Located, Query, ServerState, matches_of, pose_in, transform_of
    from semloc_core.matching.layout.building.layout import LayoutPart
    from semloc_core.matching.layout.confidence import (
        FEATURES,
        MOST_SURE,
        SHARPNESS,
        Calibration,
        Tested,
        confidence,
        features,
        near_figures,
        other_figures,
        perfect,
    )
    from semloc_core.matching.layout.config import LayoutConfig
    from semloc_core.matching.layout.evidence import Evidence, evidence_at
    from semloc_core.matching.layout.fragment import Fragment, fragment_of_arrays, fragment_of_graph
    from semloc_core.matching.layout.pose.placed import Placed, placed
    from semloc_core.matching.layout.verifier import LayoutVerifier, Verified
    from semloc_core.matching.observation import (
        REACH_M,
        RING_CENTRES_M,
        ObservationConfig,
        ObservationModel,
        Surroundings,
        ring_shares,
        slot_distances,
        surroundings,
    )
    from semloc_core.matching.posterior import CANDIDATES, IN_MAP, RIVALS, Ranking, modes, place_probabilities
    from semloc_core.matching.radius_index import RadiusIndex
    from semloc_core.matching.reranker import Reranked, Reranker, layout_part, share_verifier, verifier_of
else:
    __getattr__ = exports(__name__)

__all__ = [
    "CANDIDATES", "Calibration", "Evidence", "FEATURES", "Fragment", "IN_MAP", "LayoutConfig", "LayoutPart",
    "LayoutVerifier", "Localisation", "Located", "MOST_SURE", "ObservationConfig", "ObservationModel", "Placed",
    "Query", "REACH_M", "RING_CENTRES_M", "RIVALS", "RadiusIndex", "Ranking", "Reranked", "Reranker", "SHARPNESS",
    "ServerState", "Surroundings", "Tested", "Verified", "confidence", "evidence_at", "features", "fragment_of_arrays",
    "fragment_of_graph", "layout_part", "matches_of", "modes", "near_figures", "other_figures", "perfect",
    "place_probabilities", "placed", "pose_in", "ring_shares", "share_verifier", "slot_distances", "surroundings",
    "transform_of", "verifier_of",
]  # fmt: skip
