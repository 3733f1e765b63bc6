"""The paper's ablation (its Table III): depth, width, heads, and no attention at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from semloc_core.encoding import PaperConfig
from semloc_core.evaluate.paper.office import SEEDS, judge_trainings, summarise
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.training import PerturbConfig, TrainConfig

VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("1 layer", {"layers": 1}),
    ("3 layers", {"layers": 3}),
    ("hidden 32", {"hidden": 32}),
    ("hidden 128", {"hidden": 128}),
    ("1 head", {"heads": 1}),
    ("2 heads", {"heads": 2}),
    ("no GAT, 2 layers", {"gat": False}),
    ("no GAT, 3 layers", {"gat": False, "layers": 3}),
    ("paper", {}),
)
"""Rows of Table III in its order: what is said of each, and what differs from the paper's model."""


def evaluate_ablation(
    arrays: GraphArrays,
    labelspace: Labelspace,
    *,
    seeds: Sequence[int] = SEEDS,
    config: TrainConfig | None = None,
    perturbation: PerturbConfig | None = None,
    variants: Sequence[tuple[str, dict[str, Any]]] = VARIANTS,
    progress: Progress = no_progress,
) -> list[Row]:
    """Train and judge the paper's encoder with one design choice changed at a time (Table III).

    Args:
        arrays: the graph.
        labelspace: its classes.
        seeds: one training a variant and seed.
        config: options of the training; encoder and seed are overridden.
        perturbation: what makes the two variants judged; None: the paper's.
        variants: name and encoder options of each row.
        progress: told of every training step.

    Returns:
        A row a variant, of the test split: ``method`` (what was changed), ``scope``, ``layers``, ``hidden``, ``heads``
        (None without attention) and the figures of `semloc_core.evaluate.paper.office.evaluate_office`.

    """
    config = config or TrainConfig()
    rows: list[Row] = []
    for n, (name, options) in enumerate(variants):
        made = PaperConfig(**options)
        configs = [
            msgspec.structs.replace(config, encoder="paper", encoder_options=options, seed=seed) for seed in seeds
        ]
        figures = judge_trainings(
            arrays,
            labelspace,
            configs,
            perturbation,
            progress,
            name,
            n * len(seeds),
            len(variants) * len(seeds),
        )
        keys: Row = {
            "method": name,
            "layers": made.layers,
            "hidden": made.hidden,
            "heads": made.heads if made.gat else None,
        }
        rows += [row for row in summarise(keys, figures) if row["scope"] == "test"]
    return rows
