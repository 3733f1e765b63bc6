"""Answers verified by layout (`semloc_core.matching.layout`), for whole graphs and for walks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.matching import SHARPNESS, Fragment, LayoutVerifier, Verified, confidence, fragment_of_arrays
from semloc_core.sources import Bools, Walk
from semloc_core.tracking import MapModel

Similarities = NDArray[np.float32]


def layout_verifier(maps: tuple[GraphArrays, ...], n_classes: int) -> LayoutVerifier:
    """The verifier of a database of all places of all maps."""
    return LayoutVerifier(maps, [np.arange(graph.n_places) for graph in maps], n_classes)


def turned(graph: GraphArrays, rng: np.random.Generator) -> GraphArrays:
    """The same building in a frame of its own: turned about gravity and shifted, as another run's would be."""
    angle = rng.uniform(0.0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([*rng.uniform(-50.0, 50.0, 2), rng.uniform(-3.0, 3.0)])
    return replace(
        graph,
        place_positions=graph.place_positions @ turn + shift,
        object_positions=graph.object_positions @ turn + shift,
    )


def fragments_along(walk: Walk, steps: Ints, verifier: LayoutVerifier, rng: np.random.Generator) -> list[Fragment]:
    """What is around the robot at some steps of a walk, in a frame of the walk's own."""
    moved = replace(walk, graph=turned(walk.graph, rng))
    parts = (moved.part(int(step)) for step in steps)
    return [fragment_of_arrays(part, place, verifier.config) for part, place in parts]


def reranked(
    verifier: LayoutVerifier,
    fragments: list[Fragment],
    similarity: Similarities,
    only: Bools | None = None,
    chances: Floats | None = None,
) -> Ints:
    """(Q, N) answers, the verified ones first, then the most similar; N is what `metrics.RANKS` asks for.

    Args:
        verifier: of the M places of the database.
        fragments: Q.
        similarity: (Q, M) float32.
        only: (M,) the places that the robot can be at; None for all.
        chances: (Q,) where to put the probability of the best answer.

    """
    if only is not None:
        similarity = np.where(only, similarity, np.float32(-2))
    n = max(metrics.RANKS)
    best = metrics.top(similarity, 2 * n)
    answers = best[:, :n].copy()
    for q, fragment in enumerate(fragments):
        found = verifier.verify(fragment, similarity[q], only)
        if chances is not None:
            chances[q] = 0.0
        if found is not None:
            sure = confidence(found, fragment, verifier.mapped)
            if chances is not None:
                chances[q] = sure.probability[0]
            rest = best[q][~np.isin(best[q], found.rows)]
            together = np.concatenate([found.rows[sure.order], rest])[: answers.shape[1]]
            answers[q, : len(together)] = together
    return answers


def sureness(verifier: LayoutVerifier, found: Verified, fragment: Fragment) -> float:
    """P(the best place is within the match radius of the robot)."""
    return float(confidence(found, fragment, verifier.mapped).probability[0])


def verified_evidence(
    places: MapModel,
    verifier: LayoutVerifier,
    fragments: list[Fragment],
    similarity: Similarities,
    evidence: Similarities,
) -> Similarities:
    """(T, M) the filter's evidence (T, M) after each step's fragment was verified."""
    rows = []
    for step, fragment in enumerate(fragments):
        found = verifier.verify(fragment, similarity[step])
        if found is None:
            rows.append(evidence[step])
        else:
            rows.append(places.tested(evidence[step], found.rows, found.score.astype(np.float32), SHARPNESS))
    return np.stack(rows)
