"""The paper's protocol on one graph (its Table II).

Two perturbed variants of the graph; places split 70/20/10; the query is a place of one variant, the database the
places of the same split in the other; a map place within 4 m of the query is a positive. F1's threshold is fitted on
the validation split. Bag of words is judged on the very same variants and splits.

The paper words Recall@N as "the probability that a correct match appears among the top N" (success@N here), but
its figures can only be positives found ÷ all positives (see `semloc_core.metrics`): ``recall@N`` is that,
``recall_ceiling@N`` the most it could be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np

from semloc_core import metrics
from semloc_core.encoding import Model, build_encoder, embed_graph, similarity_matrix
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.training import (
    PARTS,
    Part,
    PerturbConfig,
    Report,
    Split,
    TrainConfig,
    perturb,
    positive_pairs,
    split_places,
    train,
)

LossName = Literal["contrastive", "triplet", "infonce"]

LOSSES: tuple[LossName, ...] = ("contrastive", "triplet", "infonce")
SEEDS = (0, 1, 2)
JUDGED: dict[str, Part] = {"val": "validation", "test": "test"}

# The variants judged come from a stream of their own: training never sees them.
_EVALUATION = 100


def evaluate_office(
    arrays: GraphArrays,
    labelspace: Labelspace,
    *,
    losses: Sequence[LossName] = LOSSES,
    seeds: Sequence[int] = SEEDS,
    config: TrainConfig | None = None,
    perturbation: PerturbConfig | None = None,
    progress: Progress = no_progress,
) -> list[Row]:
    """Train the paper's encoder with each loss and judge it beside bag of words (Table II).

    Args:
        arrays: the graph.
        labelspace: its classes.
        losses: which losses.
        seeds: one training a loss and seed; a seed also draws split and variants.
        config: options of the training; loss and seed are overridden.
        perturbation: what makes the two variants; None: the paper's displacement by class mobility.
        progress: told of every training step.

    Returns:
        For each loss and then bag of words a row a scope (``val``, ``test``): ``method``, ``loss``, ``pr_auc``, ``f1``,
        ``recall@N``, ``recall_ceiling@N``, ``success@N`` for N = 1, 5, 10, ``queries``: means over the seeds, each with
        its deviation as ``<figure>_std``.

    Raises:
        TrainingError: the graph can't be trained on.
        ConfigError: a split without a positive pair.

    """
    config = config or TrainConfig()
    rows: list[Row] = []
    for n, loss in enumerate(losses):
        words = f"paper, {loss}"
        configs = [msgspec.structs.replace(config, loss=loss, seed=seed) for seed in seeds]
        figures = judge_trainings(
            arrays,
            labelspace,
            configs,
            perturbation,
            progress,
            words,
            n * len(seeds),
            len(losses) * len(seeds),
        )
        rows += summarise({"method": config.encoder, "loss": loss}, figures)
    rows += summarise({"method": "bag_of_words", "loss": None}, judge_baseline(arrays, labelspace, seeds, perturbation))
    return rows


def judge_trainings(
    arrays: GraphArrays,
    labelspace: Labelspace,
    configs: Sequence[TrainConfig],
    perturbation: PerturbConfig | None,
    progress: Progress,
    words: str,
    done: int,
    total: int,
) -> list[dict[str, dict[str, float]]]:
    """Train once for each configuration (seed) and judge each model: figures by scope, one item a training."""
    found = []
    for n, config in enumerate(configs, start=done):

        def report(step: Report, n: int = n, config: TrainConfig = config) -> None:
            progress(n * config.steps + step.step, total * config.steps, f"{words}, seed {config.seed}")

        result = train([arrays], labelspace, config, progress=report)
        variants = office_variants(arrays, labelspace, config.seed, perturbation)
        found.append(judge_model(result.model, variants, result.splits[0], config.positive_radius_m))
        progress((n + 1) * config.steps, total * config.steps, f"{words}, seed {config.seed}")
    return found


def judge_baseline(
    arrays: GraphArrays,
    labelspace: Labelspace,
    seeds: Sequence[int],
    perturbation: PerturbConfig | None = None,
    encoder: str = "bag_of_words",
) -> list[dict[str, dict[str, float]]]:
    """Judge an encoder that has nothing to train, on the splits and variants of the seeds."""
    model = Model(build_encoder(encoder, None, len(labelspace)), labelspace)
    radius_m = TrainConfig().positive_radius_m
    return [
        judge_model(
            model,
            office_variants(arrays, labelspace, seed, perturbation),
            split_places(arrays, seed),
            radius_m,
        )
        for seed in seeds
    ]


def office_variants(
    arrays: GraphArrays, labelspace: Labelspace, seed: int, perturbation: PerturbConfig | None = None
) -> tuple[GraphArrays, GraphArrays]:
    """The two perturbed variants that a seed is judged on: (query, map)."""
    perturbation = perturbation or PerturbConfig()
    query, reference = (
        perturb(arrays, labelspace, perturbation, np.random.default_rng([seed, _EVALUATION, n])) for n in (0, 1)
    )
    return query, reference


def judge_model(
    model: Model, variants: tuple[GraphArrays, GraphArrays], split: Split, radius_m: float
) -> dict[str, dict[str, float]]:
    """Figures of a model on the validation and the test split, by scope (``val``, ``test``).

    Args:
        model: any encoder.
        variants: (query, map).
        split: of the graph that both are variants of.
        radius_m: map places within this distance of the query are positives.

    Raises:
        ConfigError: the validation split has no positive pair.

    """
    query, reference = variants
    z_query, z_map = embed_graph(model, query), embed_graph(model, reference)
    query_parts, map_parts = split.parts_of(query), split.parts_of(reference)
    pairs = {}
    for scope, part in JUDGED.items():
        asked, known = query_parts == PARTS.index(part), map_parts == PARTS.index(part)
        pairs[scope] = (
            similarity_matrix(z_query[asked], z_map[known]),
            positive_pairs(query.place_positions[asked], reference.place_positions[known], radius_m),
        )
    threshold = metrics.fit_threshold(*pairs["val"])
    return {
        scope: {
            "pr_auc": metrics.pr_auc(similarity, positive),
            "f1": metrics.f1_at(similarity, positive, threshold),
            **metrics.retrieval(similarity, positive),
        }
        for scope, (similarity, positive) in pairs.items()
    }


def summarise(keys: Row, figures: Sequence[dict[str, dict[str, float]]]) -> list[Row]:
    """One row a scope: the keys, the scope, and mean and deviation of each figure over the repetitions.

    ``queries`` is a count, summed over the repetitions.
    """
    rows: list[Row] = []
    for scope in figures[0]:
        found = [{name: value for name, value in one[scope].items() if name != "queries"} for one in figures]
        queries = sum(int(one[scope]["queries"]) for one in figures)
        rows.append({**keys, "scope": scope, **metrics.mean_and_deviation(found), "queries": queries})
    return rows
