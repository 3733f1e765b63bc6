"""The steps of a training: batches, losses, the optimiser, looks at the validation split, and its state."""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch
from torch import Tensor

from semloc_core.encoding import Batch, Encoder, take_stars, union
from semloc_core.errors import TrainingError
from semloc_core.graph import Floats, Ints
from semloc_core.training.config import TrainConfig
from semloc_core.training.losses import Loss, build_loss, ignore_radius
from semloc_core.training.state import Progress, TrainingState, save_state
from semloc_core.training.validation import judge
from semloc_core.training.views.fragments import join
from semloc_core.training.views.variants import Variant, VariantPool, pair_masks

logger = logging.getLogger(__name__)

_BATCHES = 3
"""Stream of randomness under the seed, among those of `semloc_core.training.loop`."""


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


class Steps:
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
