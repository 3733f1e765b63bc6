"""Self-supervised training on map graphs: perturbed variants of a building, losses, the seeded and resumable loop."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.training.config import DEFAULT_ENCODER, PERTURBATIONS, PerturbConfig, TrainConfig, train_config
    from semloc_core.training.curve import plot_curve
    from semloc_core.training.held_out import own_validation
    from semloc_core.training.loop import TrainResult, train
    from semloc_core.training.losses import infonce
    from semloc_core.training.split import PARTS, Part, Split, positive_pairs, split_places
    from semloc_core.training.steps import Report
    from semloc_core.training.validation import honest_temperature
    from semloc_core.training.views.perturb import displace_objects, mislabel_objects, perturb
else:
    __getattr__ = exports(__name__)

__all__ = [
    "DEFAULT_ENCODER", "PARTS", "PERTURBATIONS", "Part", "PerturbConfig", "Report", "Split", "TrainConfig",
    "TrainResult", "displace_objects", "honest_temperature", "infonce", "mislabel_objects", "own_validation",
    "perturb", "plot_curve", "positive_pairs", "split_places", "train", "train_config",
]  # fmt: skip
