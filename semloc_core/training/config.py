"""Training's options: one source of default, unit, range and description for library and command line."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from semloc_core.config import MATCH_RADIUS_M, checked


class PerturbConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is done to a building to get another day's view of it; the defaults change nothing but objects' places.

    With the defaults this is the paper's perturbation (section IV-B2): objects displaced by class-specific mobility.
    """

    mobility_scale: Annotated[
        float,
        Meta(
            ge=0.0,
            le=20.0,
            description="factor on each class's mobility (standard deviation of x and of y, in m)",
        ),
    ] = 1.0
    jitter_m: Annotated[
        float,
        Meta(ge=0.0, le=5.0, description="standard deviation of x and of y added to every object, in m"),
    ] = 0.0
    drop_probability: Annotated[float, Meta(ge=0.0, le=1.0, description="probability that an object is missed")] = 0.0
    false_ratio: Annotated[
        float,
        Meta(
            ge=0.0,
            le=5.0,
            description="invented objects, as a share of the building's objects (Poisson mean)",
        ),
    ] = 0.0
    mislabel_probability: Annotated[
        float, Meta(ge=0.0, le=1.0, description="probability that an object gets another class")
    ] = 0.0
    resample_probability: Annotated[
        float,
        Meta(ge=0.0, le=1.0, description="probability that the building's places are sampled anew"),
    ] = 0.0
    edge_drop_probability: Annotated[
        float,
        Meta(
            ge=0.0,
            le=1.0,
            description="probability that a traversability edge is not found, so that ways are longer or none",
        ),
    ] = 0.0
    spacing_low: Annotated[
        float,
        Meta(
            ge=0.2,
            le=5.0,
            description="least spacing of places sampled anew, as a factor on the original spacing",
        ),
    ] = 0.8
    spacing_high: Annotated[
        float,
        Meta(
            ge=0.2,
            le=5.0,
            description="largest spacing of places sampled anew, as a factor on the original spacing",
        ),
    ] = 1.2


class TrainConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `semloc_core.training.loop.train`; each field's metadata says what it is and its range."""

    encoder: Annotated[str, Meta(description="the encoder's name")] = "paper"
    encoder_options: Annotated[
        dict[str, Any], Meta(description="options of the encoder that differ from its defaults")
    ] = msgspec.field(default_factory=dict)
    loss: Annotated[
        Literal["infonce", "triplet", "contrastive", "mil_nce"],
        Meta(description="the loss (paper, Table II; mil_nce: InfoNCE that asks for one of the positives, not all)"),
    ] = "infonce"
    margin: Annotated[
        float, Meta(gt=0.0, le=2.0, description="margin of the contrastive loss, a distance of unit vectors")
    ] = 1.0
    triplet_margin: Annotated[
        float, Meta(gt=0.0, le=2.0, description="margin of the triplet loss, a distance of unit vectors")
    ] = 0.2
    triplet_mining: Annotated[
        Literal["hard_negative", "batch_hard"],
        Meta(description="each positive, or only the farthest one, against the nearest negative"),
    ] = "hard_negative"
    triplet_gap_m: Annotated[
        float,
        Meta(
            ge=0.0,
            le=1000.0,
            description="how far beyond the positive radius the triplet loss's negatives begin, in m",
        ),
    ] = 4.0
    temperature: Annotated[float, Meta(gt=0.0, le=10.0, description="temperature T of InfoNCE")] = 0.7
    positive_radius_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="places within this 3D distance are one answer, in m")
    ] = MATCH_RADIUS_M
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1, description="seed of weights, split, perturbations and batches")] = 0
    steps: Annotated[int, Meta(ge=1, le=10_000_000, description="optimiser steps")] = 180
    learning_rate: Annotated[float, Meta(gt=0.0, le=1.0, description="Adam's step size at the start")] = 1e-2
    warmup_steps: Annotated[int, Meta(ge=0, description="steps over which the step size rises from zero")] = 10
    weight_decay: Annotated[float, Meta(ge=0.0, le=1.0, description="Adam's L2 penalty")] = 0.0
    gradient_clip: Annotated[
        float, Meta(gt=0.0, description="largest norm of a step's gradient before it is scaled down")
    ] = 5.0
    buildings_per_step: Annotated[
        int, Meta(ge=1, le=1000, description="buildings in one step; places of others are negatives")
    ] = 4
    anchors_per_building: Annotated[
        int, Meta(ge=1, le=100_000, description="query places of one building in one step, at most")
    ] = 1000
    pool: Annotated[
        int,
        Meta(ge=2, le=1000, description="perturbed variants of each building that are kept to draw pairs from"),
    ] = 24
    refresh_steps: Annotated[
        int,
        Meta(ge=1, description="steps after which the oldest variant of each building is replaced by a new one"),
    ] = 1
    perturb: Annotated[PerturbConfig, Meta(description="what makes the training pairs")] = PerturbConfig()
    perturb_map: Annotated[
        PerturbConfig | None, Meta(description="what makes the mapped side of training pairs; null: the same")
    ] = None
    redecorated: Annotated[
        int,
        Meta(ge=0, le=1000, description="copies of each building with other objects that are trained on too"),
    ] = 0
    fragment_walks: Annotated[
        int, Meta(ge=0, le=1000, description="walks a variant whose fragments of the graph are queries too")
    ] = 0
    fragment_stops: Annotated[int, Meta(ge=1, le=1000, description="fragments a walk, at most")] = 6
    fragment_length_m: Annotated[float, Meta(gt=0.0, le=1e4, description="length of such a walk, in m")] = 60.0
    warm_start_variants: Annotated[
        int,
        Meta(ge=0, le=1000, description="pairs of variants of each building that a warm start is made from"),
    ] = 0
    validate: Annotated[PerturbConfig, Meta(description="what makes the validation pairs")] = PerturbConfig()
    validate_steps: Annotated[int, Meta(ge=1, description="steps between two looks at the validation split")] = 20
    validation_pairs: Annotated[
        int, Meta(ge=1, le=100, description="pairs of variants of each building that a look averages over")
    ] = 2
    patience: Annotated[
        int, Meta(ge=1, description="looks at the validation split without gain after which training stops")
    ] = 10
    max_seconds: Annotated[
        Annotated[float, Meta(gt=0.0)] | None,
        Meta(description="stop after so many seconds; the result then depends on the machine's speed"),
    ] = None


NEW_RUN = PerturbConfig(
    mobility_scale=0.0,
    jitter_m=0.4,
    drop_probability=0.3,
    false_ratio=0.3,
    mislabel_probability=0.08,
    resample_probability=1.0,
    edge_drop_probability=0.15,
)
"""A new run, with more missed and invented than a detector does: what is learned must bear more than it will meet."""

PERTURBATIONS: dict[str, PerturbConfig] = {
    "paper": PerturbConfig(),
    "detector": PerturbConfig(
        jitter_m=0.1,
        drop_probability=0.25,
        false_ratio=0.1,
        mislabel_probability=0.05,
        resample_probability=1.0,
    ),
}
"""Named views of another day: ``paper`` moves objects only; ``detector`` is what a robot gets on a new run: its own
places, a quarter of the objects missed, others invented or mislabelled."""

ENCODER_TRAINING: dict[str, dict[str, Any]] = {
    "geodesic_attention": {
        "loss": "mil_nce",
        "temperature": 0.07,
        "learning_rate": 1e-3,
        "warmup_steps": 30,
        "steps": 400,
        "gradient_clip": 1.0,
        "buildings_per_step": 6,
        "anchors_per_building": 100,
        "pool": 2,
        "refresh_steps": 100_000,
        "perturb": NEW_RUN,
        "perturb_map": PerturbConfig(mobility_scale=0.0, resample_probability=0.5),
        "validate": NEW_RUN,
        "redecorated": 6,
        "fragment_walks": 7,
        "fragment_stops": 7,
        "warm_start_variants": 1,
        "validate_steps": 100,
        "validation_pairs": 1,
    }
}
"""Options that an encoder is best trained with, where they are not `TrainConfig`'s defaults."""


DEFAULT_ENCODER = "geodesic_attention"
"""What `semloc train` trains: the best encoder with attention. The paper's protocol is on the paper's encoder, which is
what `TrainConfig` has where nothing else is said."""


def train_config(encoder: str = DEFAULT_ENCODER, **options: Any) -> TrainConfig:
    """An encoder's own training options, and what differs from them.

    Raises:
        ConfigError: an option that does not exist, or a value out of its range.

    """
    made: TrainConfig = checked(TrainConfig, **{"encoder": encoder, **ENCODER_TRAINING.get(encoder, {}), **options})
    return made
