"""The paper's study of explanations on one graph: class ablation, importance, shift, fidelity, agreement (Table IV).

A run is a training with one seed, judged on that seed's two perturbed variants. Everything is computed after
training; nothing is trained anew for an ablation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from semloc_core.evaluate.hypotheses import hypothesis_rows
from semloc_core.evaluate.introspect_agreement_rows import agreement_rows
from semloc_core.evaluate.introspect_rows import table_rows
from semloc_core.evaluate.introspect_run import SHIFT_PLACES, Run, introspect_run
from semloc_core.evaluate.mobility_study import MOVED_M, PLACES, mobility_study
from semloc_core.evaluate.office import SEEDS, office_variants
from semloc_core.evaluate.rows import Progress, Row, no_progress
from semloc_core.explain.explainers import EXPLAINERS
from semloc_core.graph_arrays import GraphArrays
from semloc_core.labelspace import Labelspace
from semloc_core.training.config import PerturbConfig, TrainConfig


@dataclass(frozen=True, eq=False)
class Introspection:
    """All runs, and the rows that are printed and written."""

    runs: Sequence[Run]
    methods: Sequence[str]
    rows: list[Row] = field(default_factory=list)
    hypotheses: list[Row] = field(default_factory=list)


def introspect(
    arrays: GraphArrays,
    labelspace: Labelspace,
    *,
    seeds: Sequence[int] = SEEDS,
    config: TrainConfig | None = None,
    perturbation: PerturbConfig | None = None,
    methods: Sequence[str] = tuple(EXPLAINERS),
    n_places: int | None = None,
    shift_places: int = SHIFT_PLACES,
    moved_m: float | None = MOVED_M,
    progress: Progress = no_progress,
) -> Introspection:
    """Train once for each seed, and put each model through the study.

    Args:
        arrays: the graph.
        labelspace: its classes.
        seeds: the runs.
        config: options of the training; the seed is overridden.
        perturbation: what makes the two variants; None: the paper's.
        methods: explainers.
        n_places: how many places are explained, drawn at random by the seed; None: all.
        shift_places: how many places the shift is measured on.
        moved_m: how far objects move between the traversals of the third hypothesis; None: it is not tested, which
            saves two trainings a run.
        progress: told of every step.

    """
    from semloc_core.training.loop import Report, train

    config = config or TrainConfig()
    runs = []
    for number, seed in enumerate(seeds, start=1):

        def report(step: Report, number: int = number) -> None:
            progress(step.step, config.steps, f"run {number}, training")

        result = train([arrays], labelspace, msgspec.structs.replace(config, seed=seed), progress=report)
        variants = office_variants(arrays, labelspace, seed, perturbation)
        runs.append(
            introspect_run(
                result.model,
                *variants,
                seed=seed,
                methods=methods,
                places=_drawn(arrays.n_places, n_places, seed),
                shift_places=shift_places,
                judged=result.splits[0].mask("test"),
                progress=progress,
                words=f"run {number}",
            )
        )
    moving = []
    if moved_m is not None:
        moving = mobility_study(
            arrays, labelspace, seeds=seeds, config=config, methods=methods, moved_m=moved_m,
            n_places=min(PLACES, n_places or PLACES), progress=progress,
        )  # fmt: skip
    return Introspection(
        runs,
        methods,
        table_rows(runs, methods) + agreement_rows(runs, methods),
        hypothesis_rows(runs, methods, moving) if methods else [],
    )


def _drawn(places: int, wanted: int | None, seed: int) -> list[int] | None:
    if wanted is None or wanted >= places:
        return None
    drawn: list[int] = np.sort(np.random.default_rng([seed, 3]).choice(places, wanted, replace=False)).tolist()
    return drawn
