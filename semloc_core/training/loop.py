"""The training loop: two perturbed variants of each building, their places encoded, a loss, a step; seeded, resumable.

Self-supervised on map graphs alone (paper, section IV-B): nothing but positions says which places are the same.
"""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
import numpy as np
import torch
from torch import Tensor

from semloc_core.encoding import Batch, Encoder, Model, build_encoder, extract_all, take_stars, union
from semloc_core.errors import TrainingError
from semloc_core.graph import Floats, GraphArrays, Ints, Labelspace
from semloc_core.text import short_repr
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.losses import Loss, build_loss, ignore_radius
from semloc_core.training.split import Split, split_places
from semloc_core.training.state import Progress, TrainingState, fingerprint, load_state, save_state
from semloc_core.training.validation import fit_temperature, judge
from semloc_core.training.views.fragments import join
from semloc_core.training.views.redecorate import redecorate
from semloc_core.training.views.variants import Variant, VariantMaker, VariantPool, pair_masks
from semloc_core.training.warm_start import take_over, view_pairs

logger = logging.getLogger(__name__)
T = TypeVar("T")

# Streams of randomness under one seed; a stream's number never changes meaning, so that old seeds stay good.
_TRAINING, _VALIDATION, _BATCHES, _TEMPERATURE = 1, 2, 3, 4
_MAPPED, _REDECORATED, _WARM_START, _WARM_MAPPED = 5, 6, 7, 8


@dataclass(frozen=True)
class Report:
    """What a progress callback is told after every step.

    Args:
        step: steps done, of ``steps``.
        steps: the most there will be.
        train_loss: loss of this step.
        val_loss: at the last look at the validation split; NaN before the first.
        val_pr_auc: the same.

    """

    step: int
    steps: int
    train_loss: float
    val_loss: float
    val_pr_auc: float


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
    run = _Run(config, encoder, pool, held_out, len(trained))
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


class _Run:
    """The mutable part of a training."""

    def __init__(
        self,
        config: TrainConfig,
        encoder: Encoder,
        pool: VariantPool,
        held_out: Sequence[Sequence[tuple[Variant, Variant]]],
        n_buildings: int,
    ) -> None:
        self._config, self._encoder, self._pool = config, encoder, pool
        self._held_out, self._n_buildings = held_out, n_buildings
        self._loss: Loss = build_loss(config)
        self._optimiser = (
            torch.optim.Adam(encoder.parameters(), config.learning_rate, weight_decay=config.weight_decay)
            if encoder.trainable
            else None
        )
        self.progress = Progress()
        self.best: dict[str, Tensor] = copy.deepcopy(encoder.state_dict())

    def steps(
        self, progress: Callable[[Report], None] | None, checkpoint: Path | None, inputs: str
    ) -> Literal["steps", "patience", "time"]:
        """Train until done; says why it ended."""
        config, begun, losses = self._config, time.monotonic(), list[float]()
        while self.progress.step < config.steps:
            if self.progress.stale >= config.patience:
                return "patience"
            losses.append(self._step(self.progress.step))
            done = self.progress.step + 1
            self.progress = msgspec.structs.replace(self.progress, step=done)
            out_of_time = config.max_seconds is not None and time.monotonic() - begun > config.max_seconds
            if done % config.validate_steps == 0 or done == config.steps or out_of_time:
                self.look(sum(losses) / len(losses))
                losses = []
                if checkpoint is not None:
                    save_state(checkpoint, self._state(), inputs)
            if progress is not None:
                last = self.progress.history[-1] if self.progress.history else {}
                val = last.get("val_loss", math.nan), last.get("val_pr_auc", math.nan)
                train_loss = losses[-1] if losses else last["train_loss"]
                progress(Report(done, config.steps, train_loss, *val))
            if out_of_time:
                return "time"
        return "steps"

    def look(self, train_loss: float) -> None:
        """Judge the encoder on the validation split and remember the best."""
        state, encoder = self.progress, self._encoder
        found = [judge(encoder, pairs, "validation", self._config) for pairs in self._held_out]
        value = sum(judgement.pr_auc for judgement in found) / len(found)
        row = {
            "step": float(state.step),
            "train_loss": train_loss,
            "val_loss": sum(judgement.loss for judgement in found) / len(found),
            "val_pr_auc": value,
        }
        logger.info("step %d: loss %.4f, validation PR-AUC %.4f", state.step, train_loss, value)
        # A split without a positive pair has no PR-AUC: then the latest weights are the best there are.
        better = math.isnan(value) or value > state.best_value
        if better:
            self.best = copy.deepcopy(encoder.state_dict())
        self.progress = Progress(
            step=state.step,
            best_step=state.step if better else state.best_step,
            best_value=state.best_value if math.isnan(value) else max(state.best_value, value),
            stale=0 if better else state.stale + 1,
            history=[*state.history, row],
        )

    def restore(self, state: TrainingState) -> None:
        """Go on from a state."""
        assert self._optimiser is not None
        try:
            self._encoder.load_state_dict(state.encoder)
            self._optimiser.load_state_dict(state.optimiser)
        except (RuntimeError, ValueError, KeyError) as error:
            reason = str(error).splitlines()[0]
            raise TrainingError(f"expected a training state of this encoder (got another: {reason})") from error
        self.progress, self.best = state.progress, state.best

    def _state(self) -> TrainingState:
        assert self._optimiser is not None
        return TrainingState(self.progress, self._encoder.state_dict(), self._optimiser.state_dict(), self.best)

    def _step(self, step: int) -> float:
        """One optimiser step. All randomness is a function of seed and step."""
        assert self._optimiser is not None
        config, rng = self._config, np.random.default_rng([self._config.seed, _BATCHES, step])
        n = min(config.buildings_per_step, self._n_buildings)
        buildings = np.sort(rng.choice(self._n_buildings, n, replace=False)).tolist()
        drawn = [self._pool.draw(building, step, rng) for building in buildings]
        self._encoder.train()
        z_query, queries = self._encode([query for query, _ in drawn], rng)
        z_map, places = self._encode([reference for _, reference in drawn], rng)
        positive, ignore = pair_masks(queries, places, config.positive_radius_m, ignore_radius(config))
        swapped = None if ignore is None else ignore.T
        # Either variant may ask: the pair of passes is paid for, so both directions learn from it.
        loss = (self._loss(z_query, z_map, positive, ignore) + self._loss(z_map, z_query, positive.T, swapped)) / 2
        seen = [(query.building, query.fragments) for query, _ in drawn if query.fragments is not None]
        if seen:  # a fragment asks, and is never asked
            batch, at = join([part for _, part in seen])
            located = list(zip([building for building, _ in seen], at, strict=True))
            positive, ignore = pair_masks(located, places, config.positive_radius_m, ignore_radius(config))
            loss = loss + self._loss(self._encoder(batch), z_map, positive, ignore)
        for group in self._optimiser.param_groups:
            group["lr"] = config.learning_rate * _schedule(step, config.warmup_steps, config.steps)
        self._optimiser.zero_grad()
        torch.autograd.backward([loss])
        torch.nn.utils.clip_grad_norm_(self._encoder.parameters(), config.gradient_clip)
        self._optimiser.step()
        return float(loss.detach())

    def _encode(self, variants: Sequence[Variant], rng: np.random.Generator) -> tuple[Tensor, list[tuple[int, Floats]]]:
        """Embed the training places of some variants, a sample of them where there are too many.

        The buildings of a step go through the encoder as one graph, so that batch norm sees them all.
        """
        rows: list[Ints] = []
        at: list[tuple[int, Floats]] = []
        batches: list[Batch] = []
        stars, first = self._encoder.extraction.kind == "reach", 0
        for variant in variants:
            chosen = np.flatnonzero(variant.mask("train"))
            if len(chosen) > self._config.anchors_per_building:
                chosen = np.sort(rng.choice(chosen, self._config.anchors_per_building, replace=False))
            at.append((variant.building, variant.positions[chosen]))
            if stars:  # a star needs nothing of its neighbours
                batches.append(take_stars(variant.batch, chosen))
                chosen = np.arange(len(chosen))
            else:
                batches.append(variant.batch)
            rows.append(first + chosen)
            first += batches[-1].n_roots
        batch = batches[0] if len(batches) == 1 else union(batches)[0]
        return self._encoder(batch)[torch.from_numpy(np.concatenate(rows))], at


def _schedule(step: int, warmup: int, steps: int) -> float:
    """Factor on the step size: linear warm-up, then half a cosine down to zero (Loshchilov, Hutter 2017)."""
    if step < warmup:
        return (step + 1) / (warmup + 1)
    return 0.5 * (1 + math.cos(math.pi * (step - warmup) / max(1, steps - warmup)))


def _check_graphs(graphs: Sequence[GraphArrays]) -> None:
    if not graphs:
        raise TrainingError("expected at least one graph to train on (got none)")
    known = sum(int((graph.object_classes >= 0).sum()) for graph in graphs)
    if known == 0:
        total = sum(graph.n_objects for graph in graphs)
        raise TrainingError(f"expected at least one object of a class of the labelspace (got none of {total} objects)")
