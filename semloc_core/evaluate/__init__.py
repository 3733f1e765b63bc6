"""How good it is: the paper's protocol, whole buildings, walks, when to trust an answer, what merging is good for."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.evaluate.aliasing import Aliasing, map_aliasing, reads_labels_only
    from semloc_core.evaluate.candidates import evaluate_candidates
    from semloc_core.evaluate.detections import evaluate_detections
    from semloc_core.evaluate.fit_confidence import draw_buildings
    from semloc_core.evaluate.merge import evaluate_merge
    from semloc_core.evaluate.merge_cases import Case, LifeConfig, home_cases, world_cases
    from semloc_core.evaluate.online.another_day import AnotherDay
    from semloc_core.evaluate.online.clipper import ClipperConfig, original_clipper, register_clipper
    from semloc_core.evaluate.online.layout_ablation import evaluate_layout
    from semloc_core.evaluate.online.protocol import evaluate_online
    from semloc_core.evaluate.paper.ablation import evaluate_ablation
    from semloc_core.evaluate.paper.office import SEEDS, evaluate_office, office_variants
    from semloc_core.evaluate.relocalise import evaluate_relocalise, make_arena, read_buildings, read_distractors
    from semloc_core.evaluate.shortlisted import evaluate_shortlist
    from semloc_core.evaluate.town import Town, drawn_town, evaluate_town, mapped_building, read_town
    from semloc_core.evaluate.trust import Study, failures, study_trust
    from semloc_core.evaluate.trust_curves import (
        calibration_rows,
        condition_rows,
        reliability_points,
        status_rows,
        success_points,
        threshold_rows,
        worst,
    )
    from semloc_core.evaluate.twins import MOST_SEEN, SEEN_M, LookAlikes, look_alikes
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Aliasing", "AnotherDay", "Case", "ClipperConfig", "LifeConfig", "LookAlikes", "MOST_SEEN", "SEEDS", "SEEN_M",
    "Study", "Town", "calibration_rows", "condition_rows", "draw_buildings", "drawn_town", "evaluate_ablation",
    "evaluate_candidates", "evaluate_detections", "evaluate_layout", "evaluate_merge", "evaluate_office",
    "evaluate_online", "evaluate_relocalise", "evaluate_shortlist", "evaluate_town", "failures", "home_cases",
    "look_alikes", "make_arena", "map_aliasing", "mapped_building", "office_variants", "original_clipper",
    "read_buildings", "read_distractors", "read_town", "reads_labels_only", "register_clipper", "reliability_points",
    "status_rows", "study_trust", "success_points", "threshold_rows", "world_cases", "worst",
]  # fmt: skip
