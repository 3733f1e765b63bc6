"""How hard a generated office is, so that a model's row on it can be read beside the paper's Table II.

The paper's office is not at hand. The generator's default layout (how furniture is grouped, how large and how open the
rooms are) was chosen with `evaluate_difficulty` as the one on which bag of words scores about what it scores in the
paper; nothing else is fitted, and no score is touched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from semloc_core import metrics
from semloc_core.evaluate.paper.office import judge_baseline
from semloc_core.graph import GraphArrays
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import OfficeConfig, make_office

PAPER: Row = {"method": "bag_of_words", "scope": "paper, test", "pr_auc": 0.243, "f1": 0.360}
"""Bag of words in the paper's Table II."""

WORLD_SEEDS = tuple(range(8))


def evaluate_difficulty(
    candidates: Mapping[str, OfficeConfig] | None = None,
    *,
    world_seeds: Sequence[int] = WORLD_SEEDS,
    split_seeds: Sequence[int] = (0, 1),
    progress: Progress = no_progress,
) -> list[Row]:
    """Score bag of words, in the paper's protocol, on offices of one or several configurations.

    Args:
        candidates: name -> configuration; None: the default one.
        world_seeds: one office each.
        split_seeds: each draws a split and two variants of every office.
        progress: told of every office.

    Returns:
        For each candidate a row an office (``scope``: ``world <seed>``) and one of all (``all``), with the figures
        of the test split, means over splits (and offices) with their deviation; ``places``; ``distance``: the larger of
        the distances of PR-AUC and F1 from the paper's. The last row is the paper's own.

    """
    candidates = candidates if candidates is not None else {"default": OfficeConfig()}
    rows: list[Row] = []
    done, total = 0, len(candidates) * len(world_seeds)
    for name, config in candidates.items():
        figures: list[dict[str, float]] = []
        for seed in world_seeds:
            progress(done, total, f"{name}, world {seed}")
            world = make_office(config, np.random.default_rng(seed))
            arrays = GraphArrays.from_scene_graph(world.graph, world.labelspace, f"world {seed}")
            found = [
                {**judged["test"], "places": arrays.n_places}
                for judged in judge_baseline(arrays, world.labelspace, split_seeds)
            ]
            figures += found
            rows.append(_row(name, f"world {seed}", found))
            done += 1
        rows.append(_row(name, "all", figures))
    progress(total, total, "done")
    return [*rows, dict(PAPER)]


def _row(layout: str, scope: str, figures: Sequence[dict[str, float]]) -> Row:
    mean = metrics.mean_and_deviation(figures)
    distance = max(abs(mean[name] - float(PAPER[name] or 0.0)) for name in ("pr_auc", "f1"))
    return {"method": "bag_of_words", "layout": layout, "scope": scope, **mean, "distance": distance}
