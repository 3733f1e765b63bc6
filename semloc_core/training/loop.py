"""The training loop: two perturbed variants of each building, their places encoded, a loss, a step; seeded, resumable.

Self-supervised on map graphs alone (paper, section IV-B): nothing but positions says which places are the same.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
import numpy as np
import torch

from semloc_core.encoding import Encoder, Model, build_encoder, extract_all
from semloc_core.errors import TrainingError
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.text import short_repr
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.split import Split, split_places
from semloc_core.training.state import fingerprint, load_state
from semloc_core.training.steps import Report, Steps
from semloc_core.training.validation import fit_temperature
from semloc_core.training.views.redecorate import redecorate
from semloc_core.training.views.variants import Variant, VariantMaker, VariantPool
from semloc_core.training.warm_start import take_over, view_pairs

logger = logging.getLogger(__name__)
T = TypeVar("T")

# Streams of randomness under one seed; a stream's number never changes meaning, so that old seeds stay good.
_TRAINING, _VALIDATION, _TEMPERATURE = 1, 2, 4
_MAPPED, _REDECORATED, _WARM_START, _WARM_MAPPED = 5, 6, 7, 8


@short_repr
@dataclass(frozen=True, eq=False)
class TrainResult:
    """A trained model and how it came to be.

    Args:
        model: the weights of the best look at the validation split, with the fitted temperature.
        history: one row a look: ``step``, ``train_loss`` (mean since the last look), ``val_loss``, ``val_pr_auc``.
        splits: one a building, in the order given.
        best_step: the step whose weights the model has.
        stopped: why training ended.

    """

    model: Model
    history: list[dict[str, float]]
    splits: list[Split]
    best_step: int
    stopped: Literal["steps", "patience", "time", "nothing to train"]


def train(
    graphs: Sequence[GraphArrays],
    labelspace: Labelspace,
    config: TrainConfig | None = None,
    *,
    progress: Callable[[Report], None] | None = None,
    resume: Path | None = None,
    checkpoint: Path | None = None,
    start: Model | None = None,
    preparing: Callable[[int, int], None] | None = None,
) -> TrainResult:
    """Train an encoder on the graphs of one or more buildings.

    Same graphs, options and number of threads: same weights, bit by bit, also when interrupted and resumed. An
    encoder without weights only counts on the map graphs what it counts (`Encoder.fit`) and gets its temperature.

    Args:
        graphs: the buildings, as mapped; classes by index into the labelspace.
        labelspace: classes and their mobility.
        config: options; None for the defaults.
        progress: called after each step.
        resume: a training state to go on from.
        checkpoint: where to keep the training state, written at each look at the validation split.
        start: a model to go on from, in place of random weights and warm start; of this labelspace, its encoder the
            one that ``config`` names. It is what comes back where no step betters it on the validation split.
        preparing: called with views made before the first step, and how many there are to be.

    Raises:
        TrainingError: nothing to learn from (no graph, fewer than two places, no object of a known class), or a
            state or a start that does not fit.
        ConfigError: an encoder or an option of it that does not exist.

    """
    config = config or TrainConfig()
    _check_graphs(graphs)
    splits = [split_places(graph, config.seed) for graph in graphs]
    generator = torch.Generator().manual_seed(config.seed)
    encoder = build_encoder(config.encoder, config.encoder_options, len(labelspace), generator)
    if start is not None:
        take_over(encoder, start, labelspace)
    trained, parts = [*graphs], [*splits]  # first the buildings themselves
    for b, graph in enumerate(graphs):
        for k in range(config.redecorated):
            trained.append(redecorate(graph, graphs, np.random.default_rng([config.seed, _REDECORATED, b, k])))
            parts.append(splits[b])
    walks = (config.fragment_walks, config.fragment_stops, config.fragment_length_m)

    def maker(stream: int, perturbation: PerturbConfig, fragments: bool) -> VariantMaker:
        wanted = walks if fragments and config.fragment_walks > 0 else None
        seed = (config.seed, stream)
        return VariantMaker(trained, parts, labelspace, encoder.extraction, perturbation, seed, wanted)

    asking, validating = maker(_TRAINING, config.perturb, True), maker(_VALIDATION, config.validate, False)
    asked = None if config.perturb_map is None else maker(_MAPPED, config.perturb_map, False)
    warm = config.warm_start_variants > 0 and resume is None and start is None
    made, to_make = 0, config.validation_pairs * len(graphs) + warm * len(trained) * config.warm_start_variants

    def told(view: T) -> T:
        nonlocal made
        made = min(made + 1, to_make)
        if preparing is not None:
            preparing(made, to_make)
        return view

    if preparing is not None:
        preparing(0, to_make)
    held_out = [
        [told((validating.make(b, 2 * k), validating.make(b, 2 * k + 1))) for b in range(len(graphs))]
        for k in range(config.validation_pairs)
    ]
    if warm:
        perturb_map = config.perturb if config.perturb_map is None else config.perturb_map
        views = maker(_WARM_START, config.perturb, True), maker(_WARM_MAPPED, perturb_map, False)
        encoder.warm_start(map(told, view_pairs(views, len(trained), config.warm_start_variants)))
    pool = VariantPool(asking, config.pool, config.refresh_steps, asked)
    run = Steps(config, encoder, pool, held_out, len(trained))
    encoder.fit(extract_all(graph, len(labelspace), encoder.extraction) for graph in graphs)
    inputs = fingerprint(graphs, labelspace, config) + (start.hash if start is not None else "")
    stopped: Literal["steps", "patience", "time", "nothing to train"] = "nothing to train"
    if encoder.trainable:
        if resume is not None:
            run.restore(load_state(resume, inputs))
        elif start is not None:
            run.look(math.nan)
        stopped = run.steps(progress, checkpoint, inputs)
        encoder.load_state_dict(run.best)
    else:
        run.look(math.nan)
    encoder.eval()
    state = run.progress
    model = Model(
        encoder=encoder,
        labelspace=labelspace,
        seed=config.seed,
        temperature=fit_temperature(
            encoder, _asked_of_the_map(graphs, splits, labelspace, encoder, config), config.positive_radius_m
        ),
        provenance={
            "graphs": [graph.name for graph in graphs],
            "config": msgspec.to_builtins(config),
            **({"start": start.hash} if start is not None else {}),
            "best_step": state.best_step,
            "val_pr_auc": max(state.best_value, 0.0),
            "stopped": stopped,
        },
    )
    return TrainResult(model, list(state.history), splits, state.best_step, stopped)


def _asked_of_the_map(
    graphs: Sequence[GraphArrays],
    splits: Sequence[Split],
    labelspace: Labelspace,
    encoder: Encoder,
    config: TrainConfig,
) -> list[tuple[Variant, Variant]]:
    """(query, map) of each building: a view as in validation, and the building as it was mapped."""
    views = (config.validate, PerturbConfig(mobility_scale=0.0))
    query, reference = (
        VariantMaker(graphs, splits, labelspace, encoder.extraction, view, (config.seed, _TEMPERATURE))
        for view in views
    )
    return [(query.make(b, 0), reference.make(b, 0)) for b in range(len(graphs))]


def _check_graphs(graphs: Sequence[GraphArrays]) -> None:
    if not graphs:
        raise TrainingError("expected at least one graph to train on (got none)")
    known = sum(int((graph.object_classes >= 0).sum()) for graph in graphs)
    if known == 0:
        total = sum(graph.n_objects for graph in graphs)
        raise TrainingError(f"expected at least one object of a class of the labelspace (got none of {total} objects)")
