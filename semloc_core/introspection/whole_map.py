"""Explainers over a whole map: importance of every object in expectation, and mean fidelity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding import Model, PlaceBatches, embed_graph
from semloc_core.explain import (
    BUDGET,
    BUDGETS,
    CONTROLS,
    EXPLAINERS,
    FidelityCurve,
    ObjectScores,
    SimilarityQuery,
    explain,
    fidelity_curves,
    inverted,
)
from semloc_core.graph import Floats, GraphArrays
from semloc_core.metrics import Progress, no_progress
from semloc_core.text import short_repr

INVERTED = "inverted"
"""The control that is the first explainer's ranking upside down."""


@short_repr
@dataclass(frozen=True, eq=False)
class MapIntrospection:
    """What explainers say of the places of one query graph, each paired with its own place in the map.

    Args:
        places: (Q,) indices of the places that were explained: those that see an object.
        seen: (Q, O) which objects are in reach of each.
        shares: explainer -> (Q, O) float32: an object's share of the importance, as magnitudes that sum to 1 at each
            place; zero where an object is out of reach.
        fidelity: explainer or control -> mean curves; empty where no fidelity was asked for.
        characterisation: explainer or control -> (Q,) characterisation score of each place at the budget nearest to
            `BUDGET`, so that one can be compared with another place by place.

    """

    places: NDArray[np.int64]
    seen: NDArray[np.bool_]
    shares: Mapping[str, NDArray[np.float32]]
    fidelity: Mapping[str, FidelityCurve]
    characterisation: Mapping[str, Floats]

    @cached_property
    def importance(self) -> Mapping[str, Floats]:
        """Explainer -> (O,) float64: mean share over the places, zero where there is none."""
        places = max(1, len(self.places))
        return {method: of.sum(0, dtype=np.float64) / places for method, of in self.shares.items()}


def introspect_map(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    *,
    methods: Sequence[str] = tuple(EXPLAINERS),
    places: Sequence[int] | None = None,
    budgets: Sequence[float] = BUDGETS,
    with_fidelity: bool = True,
    seed: int = 0,
    progress: Progress = no_progress,
    words: str = "explaining",
) -> MapIntrospection:
    """Explain every place of a query graph's similarity to the same place in the map.

    Args:
        model: the model; its encoder in eval mode.
        query: the perturbed graph; its places are those of ``reference``, in the same order.
        reference: the map's graph.
        methods: explainers.
        places: which places; None: all. Those without an object in reach are left out.
        budgets: ρ of the fidelity curves.
        with_fidelity: whether to compute fidelity, and with it the controls (random, and the first method inverted).
        seed: with a place's index, the seed of what samples there: a place is explained alike whoever else is.
        progress: told of every place.
        words: what ``progress`` says.

    """
    number = {id_: i for i, id_ in enumerate(query.object_ids)}
    wanted = range(query.n_places) if places is None else places
    seen = np.zeros((len(wanted), query.n_objects), dtype=np.bool_)
    laid_out = {method: np.zeros((len(wanted), query.n_objects), dtype=np.float32) for method in methods}
    curves: dict[str, list[FidelityCurve]] = {}
    explained: list[int] = []
    for done, (place, question) in enumerate(questions(model, query, reference, wanted)):
        progress(done, len(wanted), words)
        said: dict[str, ObjectScores] = {
            method: explain(question, method, np.random.default_rng([seed, place])) for method in methods
        }
        objects = [number[id_] for id_ in question.ids]
        seen[len(explained), objects] = True
        for method, scores in said.items():
            laid_out[method][len(explained), objects] = shares(scores.scores)
        explained.append(place)
        if with_fidelity:
            for control in CONTROLS:
                said[control] = explain(question, control, np.random.default_rng([seed, place]))
            if methods:
                said[INVERTED] = inverted(said[methods[0]])
            found = fidelity_curves(question, list(said.values()), budgets)
            for name, curve in zip(said, found, strict=True):
                curves.setdefault(name, []).append(curve)
    progress(len(wanted), len(wanted), words)
    fixed = int(np.argmin(np.abs(np.asarray(budgets) - BUDGET)))
    return MapIntrospection(
        places=np.array(explained, dtype=np.int64),
        seen=seen[: len(explained)],
        shares={method: values[: len(explained)] for method, values in laid_out.items()},
        fidelity={name: mean_curve(name, of_places) for name, of_places in curves.items()},
        characterisation={
            name: np.array([curve.characterisation[fixed] for curve in of_places]) for name, of_places in curves.items()
        },
    )


def questions(
    model: Model, query: GraphArrays, reference: GraphArrays, places: Iterable[int]
) -> Iterator[tuple[int, SimilarityQuery]]:
    """Places of a query graph that see an object, each asked about its similarity to the same place in the map.

    Args:
        model: the model; its encoder in eval mode.
        query: the query graph; its places are those of ``reference``, in the same order.
        reference: the map's graph.
        places: which places.

    """
    assert query.place_ids == reference.place_ids, "the two graphs must have the same places"
    targets = torch.from_numpy(embed_graph(model, reference))
    batches = PlaceBatches(query, len(model.labelspace), model.encoder.extraction)
    names = np.array([*model.labelspace.classes, "?"])
    for place in places:
        batch = batches.of(place)
        if not bool(batch.is_object.any()):
            continue
        of_node = torch.where(batch.features.any(1), batch.features.argmax(1), -1).tolist()
        yield place, SimilarityQuery.from_encoder(model.encoder, batch, targets[place], names[of_node].tolist())


def shares(scores: Floats) -> Floats:
    """Magnitudes scaled to sum to 1; equal where all are zero."""
    magnitude = np.abs(scores)
    total = magnitude.sum()
    found: Floats = magnitude / total if total > 0 else np.full(len(scores), 1.0 / max(1, len(scores)))
    return found


def mean_curve(name: str, curves: Sequence[FidelityCurve]) -> FidelityCurve:
    """Mean over places (paper: "averaged over all place–query pairs"), of the characterisation score too."""
    return FidelityCurve(
        method=name,
        budgets=curves[0].budgets,
        necessity=np.mean([curve.necessity for curve in curves], axis=0),
        sufficiency=np.mean([curve.sufficiency for curve in curves], axis=0),
        characterisation=np.mean([curve.characterisation for curve in curves], axis=0),
    )
