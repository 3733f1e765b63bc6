"""Are explanations about the model: they must change with its weights, and should not hang on a free choice."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from semloc_core.encoding import Model
from semloc_core.explain import BASELINES, EXPLAINERS, ObjectScores, SimilarityQuery, explain, integrated_gradients
from semloc_core.graph import Floats, GraphArrays
from semloc_core.introspection.agreement.ranks import spearman
from semloc_core.introspection.whole_map import questions
from semloc_core.metrics import Progress, Row, no_progress

FINER = 8
"""How many times as many steps Integrated Gradients is tried with."""
PLACES = 20
"""Places of a run that are explained anew for every shuffled layer."""


def sanity_rows(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    explained: NDArray[np.int64],
    *,
    run: int = 1,
    methods: Sequence[str] = tuple(EXPLAINERS),
    n_places: int = PLACES,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """Both checks on some places of a run, drawn at random: `randomisation_rows`, then `baseline_rows`.

    Args:
        model: of the run.
        query: its query graph.
        reference: its map's graph.
        explained: places to draw from.
        run: written into every row.
        methods: explainers; the second check is made where Integrated Gradients is one of them.
        n_places: how many are drawn.
        seed: of the draw and of the checks.
        progress: told of every shuffled layer.

    """
    count = min(n_places, len(explained))
    places = np.sort(np.random.default_rng([seed, 6]).choice(explained, count, replace=False)).tolist()
    rows = randomisation_rows(
        model, query, reference, places, methods=methods, seed=seed,
        progress=lambda done, total, words: progress(done, total, f"run {run}, {words}"),
    )  # fmt: skip
    if "integrated_gradients" in methods:
        rows += baseline_rows(model, query, reference, places)
    return [{**row, "run": run} for row in rows]


def mean_rows(rows: Sequence[Row]) -> list[Row]:
    """`sanity_rows` of several runs, with their figures averaged over the runs."""
    found: list[Row] = []
    for key in dict.fromkeys((row["method"], row["scope"], row["way"]) for row in rows):
        same = [row for row in rows if (row["method"], row["scope"], row["way"]) == key]
        mean: Row = dict(zip(("method", "scope", "way"), key, strict=True))
        for name in ("spearman", "gap"):
            known = [float(row[name] or 0.0) for row in same if name in row and not np.isnan(float(row[name] or 0.0))]
            if known:
                mean[name] = float(np.mean(known))
        found.append(mean)
    return found


def randomisation_rows(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    places: Sequence[int],
    *,
    methods: Sequence[str] = tuple(EXPLAINERS),
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """The model-randomisation check: how alike attributions are when weights are shuffled, layer by layer.

    Adebayo et al., "Sanity Checks for Saliency Maps", NeurIPS 2018. From the output to the input each layer's weights
    are permuted, those above it staying so (``cascading``), and also each layer alone (``alone``). An explainer whose
    attributions stay much the same (a correlation near 1) does not look at the model.

    Args:
        model: the model; its encoder in eval mode. It is not changed.
        query: the query graph; its places are those of ``reference``.
        reference: the map's graph.
        places: the places to explain.
        methods: explainers.
        seed: of the permutations and of what samples.
        progress: told of every shuffled layer.

    Returns:
        A row a method, layer and way: ``method``, ``scope`` (the layer), ``way``, ``spearman``: the mean over the
        places of the rank correlation with the attributions of the model as it is (NaN where there is none).

    """
    before = _scores(model, query, reference, places, methods, seed)
    rows: list[Row] = []
    total = 2 * len(_layers(model.encoder))
    for cascading in (True, False):
        for layer, shuffled in _shuffled(model, cascading, np.random.default_rng([seed, 2])):
            progress(len(rows) // max(1, len(methods)), total, f"{layer} shuffled")
            after = _scores(shuffled, query, reference, places, methods, seed)
            rows += [
                {
                    "method": method,
                    "scope": layer,
                    "way": "cascading" if cascading else "alone",
                    "spearman": _mean_correlation(before[method], after[method]),
                }
                for method in methods
            ]
    return rows


def baseline_rows(
    model: Model, query: GraphArrays, reference: GraphArrays, places: Sequence[int], *, steps: int = 50
) -> list[Row]:
    """How much Integrated Gradients hangs on its baseline and on its steps: rank correlation with scores from zero.

    Returns:
        A row a baseline, and one of more steps: ``method``, ``scope`` (the baseline), ``way`` (``baseline``),
        ``spearman`` and ``gap``, the mean magnitude of the completeness gap over the places.

    """
    asked = list(_questions(model, query, reference, places))
    found: dict[str, list[ObjectScores]] = {
        baseline: [integrated_gradients(question, steps=steps, baseline=baseline) for question in asked]
        for baseline in BASELINES
    }
    found[f"zero, {FINER * steps} steps"] = [integrated_gradients(question, steps=FINER * steps) for question in asked]
    return [
        {
            "method": "integrated_gradients",
            "scope": baseline,
            "way": "baseline",
            "spearman": _mean_correlation([s.scores for s in found["zero"]], [s.scores for s in scores]),
            "gap": float(np.mean([abs(s.completeness_gap or 0.0) for s in scores])),
        }
        for baseline, scores in found.items()
    ]


def _questions(
    model: Model, query: GraphArrays, reference: GraphArrays, places: Sequence[int]
) -> Iterator[SimilarityQuery]:
    """The places with at least three objects in reach: on fewer a rank correlation says nothing."""
    return (question for _, question in questions(model, query, reference, places) if question.n_objects >= 3)


def _scores(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    places: Sequence[int],
    methods: Sequence[str],
    seed: int,
) -> dict[str, list[Floats]]:
    found: dict[str, list[Floats]] = {method: [] for method in methods}
    for number, question in enumerate(_questions(model, query, reference, places)):
        for method in methods:
            found[method].append(explain(question, method, np.random.default_rng([seed, number])).scores)
    return found


def _shuffled(model: Model, cascading: bool, rng: np.random.Generator) -> Iterator[tuple[str, Model]]:
    """The model with one more layer's weights permuted each time, from the output on; or with that layer's only."""
    layers = _layers(model.encoder)
    encoder = copy.deepcopy(model.encoder)
    for layer in reversed(layers):
        if not cascading:
            encoder = copy.deepcopy(model.encoder)
        with torch.no_grad():
            for name in layers[layer]:
                parameter = encoder.get_parameter(name)
                order = torch.from_numpy(rng.permutation(parameter.numel()))
                parameter.copy_(parameter.flatten()[order].view_as(parameter))
        yield layer, Model(encoder, model.labelspace, model.seed, model.temperature)


def _layers(encoder: nn.Module) -> dict[str, list[str]]:
    """Parts that have weights, in order -> names of their weights; of a list of layers each for itself."""
    found: dict[str, list[str]] = {}
    for name, _ in encoder.named_parameters():
        parts = name.split(".")
        listed = isinstance(getattr(encoder, parts[0]), nn.ModuleList)
        found.setdefault(".".join(parts[: 2 if listed else 1]), []).append(name)
    return found


def _mean_correlation(before: Sequence[Floats], after: Sequence[Floats]) -> float:
    each = [spearman(a, b)[0] for a, b in zip(before, after, strict=True)]
    defined = [rho for rho in each if not np.isnan(rho)]
    return float(np.mean(defined)) if defined else float("nan")
