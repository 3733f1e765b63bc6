"""The paper's study of explanations on one graph: class ablation, importance, shift, fidelity, agreement (Table IV).

A run is a training with one seed, judged on that seed's two perturbed variants. Everything is computed after
training; nothing is trained anew for an ablation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.evaluate.introspect_ablation import (
    ablate_classes,
    class_frequencies,
    importance_shift,
    spread,
    without_class,
)
from semloc_core.evaluate.introspect_agreement import kendall_w, spearman
from semloc_core.evaluate.introspect_map import MapIntrospection, introspect_map
from semloc_core.evaluate.office import SEEDS, office_variants
from semloc_core.evaluate.rows import Progress, Row, no_progress
from semloc_core.explain.explainers import EXPLAINERS
from semloc_core.graph_arrays import GraphArrays
from semloc_core.labelspace import Labelspace
from semloc_core.model import Model
from semloc_core.training.config import PerturbConfig, TrainConfig

Floats = NDArray[np.float64]
ABLATION = "ablation"
SHIFT_PLACES = 150


@dataclass(frozen=True, eq=False)
class Run:
    """One run's figures; of each explainer and, under ``ablation``, of class removal.

    Args:
        seed: the run's.
        query: the query graph.
        frequency: class -> part of the objects.
        drop: class -> loss of PR-AUC without it.
        introspection: importance of objects and fidelity, over all places.
        importance: explainer -> class -> mean share of the importance.
        shift: explainer -> class -> Jensen–Shannon divergence over all objects.
        shift_of_rest: the same over the objects that remain.

    """

    seed: int
    query: GraphArrays
    frequency: Mapping[str, float]
    drop: Mapping[str, float]
    introspection: MapIntrospection
    importance: Mapping[str, Mapping[str, float]]
    shift: Mapping[str, Mapping[str, float]]
    shift_of_rest: Mapping[str, Mapping[str, float]]

    def scores(self, method: str) -> dict[str, float]:
        """What Table IV ranks classes by: loss of PR-AUC, or shift, divided by class frequency."""
        of = self.drop if method == ABLATION else self.shift[method]
        return {name: of[name] / self.frequency[name] for name in self.frequency}

    def ranking(self, method: str) -> list[str]:
        """Classes by falling score, ties by name."""
        scores = self.scores(method)
        return sorted(scores, key=lambda name: (-scores[name], name))


@dataclass(frozen=True, eq=False)
class Introspection:
    """All runs, and the rows that are printed and written."""

    runs: Sequence[Run]
    rows: list[Row] = field(default_factory=list)


def introspect(
    arrays: GraphArrays,
    labelspace: Labelspace,
    *,
    seeds: Sequence[int] = SEEDS,
    config: TrainConfig | None = None,
    perturbation: PerturbConfig | None = None,
    methods: Sequence[str] = tuple(EXPLAINERS),
    shift_places: int = SHIFT_PLACES,
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
        shift_places: how many places the shift is measured on.
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
                shift_places=shift_places,
                progress=progress,
                words=f"run {number}",
            )
        )
    return Introspection(runs, table_rows(runs, methods) + agreement_rows(runs, methods))


def introspect_run(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    *,
    seed: int = 0,
    methods: Sequence[str] = tuple(EXPLAINERS),
    places: Sequence[int] | None = None,
    shift_places: int = SHIFT_PLACES,
    progress: Progress = no_progress,
    words: str = "run",
) -> Run:
    """Put one model through the study.

    Args:
        model: the model; its encoder in eval mode.
        query: the query variant; its places are those of ``reference``.
        reference: the map variant.
        seed: of explainers that sample and of the places that the shift is measured on.
        methods: explainers.
        places: places to explain; None: all.
        shift_places: how many of them the shift is measured on: it costs a pass of all explainers a class.
        progress: told of every place.
        words: what ``progress`` says first.

    """
    space = model.labelspace
    frequency = class_frequencies(reference, space)
    whole = introspect_map(
        model, query, reference, methods=methods, places=places, seed=seed, progress=progress, words=words
    )
    classes = np.array([space.classes[c] if c >= 0 else "?" for c in query.object_classes.tolist()])
    importance = {
        method: {name: float(values[classes == name].sum()) for name in frequency}
        for method, values in whole.importance.items()
    }
    count = min(shift_places, len(whole.places))
    drawn = np.random.default_rng([seed, 1]).choice(whole.places, count, replace=False)
    sample = np.sort(drawn).tolist()

    def importance_without(name: str | None) -> Mapping[str, Floats]:
        a, b = (
            (query, reference)
            if name is None
            else (without_class(query, space, name), without_class(reference, space, name))
        )
        found = introspect_map(
            model, a, b, methods=methods, places=sample, with_fidelity=False, seed=seed,
            progress=progress, words=f"{words}, without {name}" if name else words,
        )  # fmt: skip
        return {
            method: spread(values, a.object_ids, query.object_ids)
            for method, values in found.importance.items()
        }

    before = importance_without(None)
    after = {name: importance_without(name) for name in frequency}
    return Run(
        seed=seed,
        query=query,
        frequency=frequency,
        drop=ablate_classes(model, query, reference),
        introspection=whole,
        importance=importance,
        shift={
            method: {name: importance_shift(before[method], after[name][method]) for name in frequency}
            for method in methods
        },
        shift_of_rest={
            method: {
                name: importance_shift(before[method], after[name][method], classes != name)
                for name in frequency
            }
            for method in methods
        },
    )


def table_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Table IV and what is behind it: a row a method, run and class, then (fidelity) one a method, run and budget."""
    rows: list[Row] = []
    for number, run in enumerate(runs, start=1):
        for method in (ABLATION, *methods):
            scores = run.scores(method)
            for rank, name in enumerate(run.ranking(method), start=1):
                row: Row = {
                    "method": method,
                    "scope": name,
                    "run": number,
                    "rank": rank,
                    "frequency": run.frequency[name],
                    "score": scores[name],
                }
                if method == ABLATION:
                    row |= {"pr_auc_drop": run.drop[name]}
                else:
                    row |= {
                        "importance": run.importance[method][name],
                        "shift": run.shift[method][name],
                        "shift_of_rest": run.shift_of_rest[method][name],
                    }
                rows.append(row)
        for method, curve in run.introspection.fidelity.items():
            rows += [
                {
                    "method": method,
                    "scope": "all",
                    "run": number,
                    "budget": float(budget),
                    "necessity": float(curve.necessity[i]),
                    "sufficiency": float(curve.sufficiency[i]),
                    "characterisation": float(curve.characterisation[i]),
                }
                for i, budget in enumerate(curve.budgets)
            ]
    return rows


def ranking_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """Table IV: a row a method and run, with the classes by falling score under the names 1, 2 and so on."""
    rows: list[Row] = []
    for method in (ABLATION, *methods):
        for number, run in enumerate(runs, start=1):
            row: Row = {"method": method, "scope": f"run {number}"}
            for rank, name in enumerate(run.ranking(method), start=1):
                row[str(rank)] = name
            rows.append(row)
    return rows


def agreement_rows(runs: Sequence[Run], methods: Sequence[str]) -> list[Row]:
    """How far runs agree on the classes, what that has to do with frequency, and with what ablation says.

    ``kendall_w``: of the runs (with at least two, and three classes); ``frequency``: Spearman of importance per object
    with class frequency (TF–IDF would be negative); ``ablation``: Spearman of the score with ablation's, over
    classes and runs.
    """
    rows: list[Row] = []
    for method in (ABLATION, *methods):
        table = np.array([list(run.scores(method).values()) for run in runs])
        per_object = [
            value / run.frequency[name]
            for run in runs
            for name, value in (run.drop if method == ABLATION else run.importance[method]).items()
        ]
        frequency = [value for run in runs for value in run.frequency.values()]
        by_ablation = [value for run in runs for value in run.scores(ABLATION).values()]
        row: Row = {"method": method, "scope": "all"}
        if table.shape[0] >= 2 and table.shape[1] >= 3:
            row["kendall_w"] = kendall_w(table)
        for label, pair in (
            ("frequency", (per_object, frequency)),
            ("ablation", (table.ravel().tolist(), by_ablation)),
        ):
            if label == ABLATION and method == ABLATION:
                continue
            row[label], row[f"{label}_low"], row[f"{label}_high"] = spearman(*pair)
        rows.append(row)
    return rows
