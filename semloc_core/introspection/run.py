"""One model of the study: class ablation, importance of objects and of classes, shift, fidelity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model, embed_graph
from semloc_core.explain import EXPLAINERS
from semloc_core.graph import Floats, GraphArrays
from semloc_core.introspection.class_ablation import (
    ablate_classes,
    class_frequencies,
    importance_shift,
    spread,
    without_class,
)
from semloc_core.introspection.whole_map import MapIntrospection, introspect_map
from semloc_core.metrics import Progress, no_progress
from semloc_core.text import short_repr

Bools = NDArray[np.bool_]
ABLATION = "ablation"
SHIFT_PLACES = 150
SAME = 1e-5
"""Embeddings that differ by less are the same but for rounding."""


@short_repr
@dataclass(frozen=True, eq=False)
class Run:
    """One run's figures; of each explainer and, under ``ablation``, of class removal.

    Args:
        seed: the run's.
        model: the model.
        query: the query graph.
        reference: the map's graph; its places are those of ``query``.
        judged: (P,) places that PR-AUC is taken over, as queries and as the map: those held out from training.
        frequency: class -> part of the objects.
        drop: class -> loss of PR-AUC without it.
        introspection: importance of objects and fidelity, over all places.
        importance: explainer -> class -> mean share of the importance.
        shift: explainer -> class -> Jensen–Shannon divergence over all objects.
        shift_of_rest: the same over the objects that remain.

    """

    seed: int
    model: Model
    query: GraphArrays
    reference: GraphArrays
    judged: Bools
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


def introspect_run(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    *,
    seed: int = 0,
    methods: Sequence[str] = tuple(EXPLAINERS),
    places: Sequence[int] | None = None,
    shift_places: int = SHIFT_PLACES,
    judged: Bools | None = None,
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
        judged: (P,) places that PR-AUC is taken over, as queries and as the map; None: all.
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

    before = introspect_map(
        model, query, reference, methods=methods, places=sample, with_fidelity=False, seed=seed, progress=progress,
        words=f"{words}, shift",
    )  # fmt: skip
    after = {
        name: importance_without(model, query, reference, name, before, methods, seed, progress, words)
        for name in frequency
    }
    judged = np.ones(query.n_places, dtype=np.bool_) if judged is None else judged
    return Run(
        seed=seed,
        model=model,
        query=query,
        reference=reference,
        judged=judged,
        frequency=frequency,
        drop=ablate_classes(model, query, reference, query_rows=judged, map_rows=judged),
        introspection=whole,
        importance=importance,
        shift={
            method: {name: importance_shift(before.importance[method], after[name][method]) for name in frequency}
            for method in methods
        },
        shift_of_rest={
            method: {
                name: importance_shift(before.importance[method], after[name][method], classes != name)
                for name in frequency
            }
            for method in methods
        },
    )


def importance_without(
    model: Model,
    query: GraphArrays,
    reference: GraphArrays,
    name: str,
    before: MapIntrospection,
    methods: Sequence[str],
    seed: int,
    progress: Progress,
    words: str,
) -> dict[str, Floats]:
    """Explainer -> (O,) mean importance of the query's objects when all of a class are gone; zero for those.

    Where a place has none of the class in reach, and neither has the map place it is compared to, nothing changed: such
    places are taken from ``before``.
    """
    space = model.labelspace
    a, b = without_class(query, space, name), without_class(reference, space, name)
    member = query.object_classes == space.index(name)
    apart = np.abs(embed_graph(model, reference) - embed_graph(model, b))[before.places].max(axis=1, initial=0.0)
    same = ~before.seen[:, member].any(axis=1) & (apart < SAME)
    found = introspect_map(
        model, a, b, methods=methods, places=before.places[~same].tolist(), with_fidelity=False, seed=seed,
        progress=progress, words=f"{words}, without {name}",
    )  # fmt: skip
    places = max(1, int(same.sum()) + len(found.places))
    return {
        method: (
            of[same].sum(0, dtype=np.float64)
            + spread(found.shares[method].sum(0, dtype=np.float64), a.object_ids, query.object_ids)
        )
        / places
        for method, of in before.shares.items()
    }
