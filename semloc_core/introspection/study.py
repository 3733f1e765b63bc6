"""The paper's study of explanations on one graph: class ablation, importance, shift, fidelity, agreement (Table IV).

A run is a training with one seed, judged on that seed's two perturbed variants. Everything is computed after
training; nothing is trained anew for an ablation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np

from semloc_core.encoding import Model
from semloc_core.evaluate import SEEDS, office_variants
from semloc_core.explain import EXPLAINERS
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.introspection.agreement.rows import agreement_rows, explainer_rows, frequency_rows
from semloc_core.introspection.checks import check_rows
from semloc_core.introspection.controls import control_rows
from semloc_core.introspection.hypotheses import hypothesis_rows
from semloc_core.introspection.mobility_study import MOVED_M, PLACES, MobilityRun, mobility_study
from semloc_core.introspection.rows import table_rows
from semloc_core.introspection.run import SHIFT_PLACES, Run, introspect_run
from semloc_core.introspection.sanity import PLACES as SANITY_PLACES
from semloc_core.introspection.sanity import sanity_rows
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.text import short_repr
from semloc_core.training import PerturbConfig, TrainConfig, train_config


@short_repr
@dataclass(frozen=True, eq=False)
class Introspection:
    """All runs, and the rows that are printed and written.

    Args:
        runs: a run a seed.
        methods: explainers.
        mobility: of the third hypothesis; empty where it was not tested.
        sanity: `semloc_core.introspection.sanity.sanity_rows` of all runs.

    """

    runs: Sequence[Run]
    methods: Sequence[str]
    mobility: Sequence[MobilityRun] = ()
    sanity: list[Row] = field(default_factory=list)

    @cached_property
    def table(self) -> list[Row]:
        """Table IV and what is behind it; the fidelity curves."""
        return table_rows(self.runs, self.methods)

    @cached_property
    def controls(self) -> list[Row]:
        """Each explainer against each control."""
        return control_rows(self.runs, self.methods)

    @cached_property
    def agreement(self) -> list[Row]:
        """Of runs, of explainers, and with ablation."""
        return agreement_rows(self.runs, self.methods)

    @cached_property
    def frequency(self) -> list[Row]:
        """Importance and class frequency."""
        return frequency_rows(self.runs, self.methods)

    @cached_property
    def hypotheses(self) -> list[Row]:
        """The paper's three expectations; none without an explainer."""
        return hypothesis_rows(self.runs, self.methods, self.mobility) if self.methods else []

    @cached_property
    def checks(self) -> list[Row]:
        """Which explainers passed: what is to be read first."""
        return check_rows(self.methods, self.controls, self.sanity)

    @property
    def rows(self) -> list[Row]:
        """All of them, as they are written."""
        between = explainer_rows(self.runs, self.methods)
        return [
            *self.checks, *self.table, *self.controls, *self.agreement, *between, *self.frequency, *self.sanity,
            *self.hypotheses,
        ]  # fmt: skip


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
    sanity_places: int = SANITY_PLACES,
    model: Model | None = None,
    progress: Progress = no_progress,
) -> Introspection:
    """Train once for each seed, and put each model through the study; or study one model on all seeds' variants.

    Args:
        arrays: the graph.
        labelspace: its classes.
        seeds: the runs.
        config: options of the training, the encoder among them; None: the paper's encoder. The seed is overridden.
        perturbation: what makes the two variants; None: the paper's.
        methods: explainers.
        n_places: how many places are explained, drawn at random by the seed; None: all.
        shift_places: how many places the shift is measured on.
        moved_m: how far objects move between the traversals of the third hypothesis; None: it is not tested, which
            saves two trainings a run.
        sanity_places: how many places of each run the sanity checks explain.
        model: studied as it is: nothing is trained, all places are judged (it may have been trained on them), and the
            third hypothesis, which takes trainings, is not tested.
        progress: told of every step.

    """
    from semloc_core.training import Report, train

    config = config or train_config("paper")
    runs: list[Run] = []
    sanity: list[Row] = []
    for number, seed in enumerate(seeds, start=1):

        def report(step: Report, number: int = number) -> None:
            progress(step.step, config.steps, f"run {number}, training")

        judged = None
        if model is None:
            result = train([arrays], labelspace, msgspec.structs.replace(config, seed=seed), progress=report)
            studied, judged = result.model, result.splits[0].mask("test")
        else:
            studied = model
        variants = office_variants(arrays, labelspace, seed, perturbation)
        runs.append(
            introspect_run(
                studied,
                *variants,
                seed=seed,
                methods=methods,
                places=_drawn(arrays.n_places, n_places, seed),
                shift_places=shift_places,
                judged=judged,
                progress=progress,
                words=f"run {number}",
            )
        )
        sanity += sanity_rows(
            studied, *variants, runs[-1].introspection.places, run=number, methods=methods,
            n_places=sanity_places, seed=seed, progress=progress,
        )  # fmt: skip
    moving: list[MobilityRun] = []
    if moved_m is not None and model is None:
        moving = mobility_study(
            arrays, labelspace, seeds=seeds, config=config, methods=methods, moved_m=moved_m,
            n_places=min(PLACES, n_places or PLACES), progress=progress,
        )  # fmt: skip
    return Introspection(runs, methods, moving, sanity)


def _drawn(places: int, wanted: int | None, seed: int) -> list[int] | None:
    if wanted is None or wanted >= places:
        return None
    drawn: list[int] = np.sort(np.random.default_rng([seed, 3]).choice(places, wanted, replace=False)).tolist()
    return drawn
