"""Answers verified by layout (`semloc_core.matching.layout`), for whole graphs and for walks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.matching import (
    Confidence,
    Fragment,
    LayoutVerifier,
    Placed,
    Verified,
    confidence,
    fragment_of_arrays,
    placed,
)
from semloc_core.metrics import PoseErrors
from semloc_core.sources import Bools, Frame, Walk
from semloc_core.text import short_repr
from semloc_core.tracking import FrameFilter

Similarities = NDArray[np.float32]


def layout_verifier(maps: tuple[GraphArrays, ...], n_classes: int) -> LayoutVerifier:
    """The verifier of a database of all places of all maps."""
    return LayoutVerifier(maps, [np.arange(graph.n_places) for graph in maps], n_classes)


def any_frame(rng: np.random.Generator) -> Frame:
    """A frame of its own, as another run's would be: turned about gravity and shifted."""
    angle = float(rng.uniform(0.0, 2 * np.pi))
    x, y = rng.uniform(-50.0, 50.0, 2).tolist()
    return Frame(angle, (x, y, float(rng.uniform(-3.0, 3.0))))


def written_in(frame: Frame, graph: GraphArrays) -> GraphArrays:
    """The same building in another frame."""
    return replace(
        graph,
        place_positions=frame.of(graph.place_positions),
        object_positions=frame.of(graph.object_positions),
    )


def true_yaw(frame: Frame, walk: Walk, step: int) -> float:
    """The turn from a walk's frame, as it is at a step and written in another frame, to the building's, radians."""
    return -(frame.yaw + walk.frame(step).yaw)


def fragments_along(walk: Walk, steps: Ints, verifier: LayoutVerifier, rng: np.random.Generator) -> list[Fragment]:
    """What is around the robot at some steps of a walk, in a frame of the walk's own."""
    frame, found = any_frame(rng), []
    for step in steps.tolist():
        part, place = walk.part(step)
        found.append(
            fragment_of_arrays(written_in(frame, part), place, verifier.config, walk.ages(step), walk.drift(step))
        )
    return found


@short_repr
@dataclass(frozen=True, eq=False)
class Past:
    """A filter that sees answer after answer.

    Args:
        filter: goes on from what it knows.
        buildings: names of the database's.
        walked: (Q,) metres, by answer.

    """

    filter: FrameFilter
    buildings: tuple[str, ...]
    walked: Floats

    def weighed(
        self, sure: Confidence, verifier: LayoutVerifier, found: Verified, fragment: Fragment, q: int
    ) -> Confidence:
        """The q-th answer by all up to it."""
        about = self.buildings, fragment.origin, float(self.walked[q]), fragment.drift
        return sure.weighed(self.filter.observe(sure.answers, *about))


def reranked(
    verifier: LayoutVerifier,
    fragments: list[Fragment],
    similarity: Similarities,
    only: Bools | None = None,
    chances: Floats | None = None,
    places: list[Placed | None] | None = None,
    past: Past | None = None,
    seconds: Floats | None = None,
) -> Ints:
    """(Q, N) answers, the verified ones first, then the most similar; N is what `metrics.RANKS` asks for.

    Args:
        verifier: of the M places of the database.
        fragments: Q.
        similarity: (Q, M) float32.
        only: (M,) the places that the robot can be at; None for all.
        chances: (Q,) where to put the probability of the best answer.
        places: where to put where the robot's frame lies by the best answer.
        past: weighs each answer by those before it; None: each by itself.
        seconds: (Q,) where to add the process's own time for each.

    """
    if only is not None:
        similarity = np.where(only, similarity, np.float32(-2))
    n = max(metrics.RANKS)
    best = metrics.top(similarity, 2 * n)
    answers = best[:, :n].copy()
    for q, fragment in enumerate(fragments):
        begun = process_time()
        found = verifier.verify(fragment, similarity[q], only)
        if chances is not None:
            chances[q] = 0.0
        placing: Placed | None = None
        if found is not None:
            sure = confidence(found, fragment, verifier.mapped)
            if past is not None:
                sure = past.weighed(sure, verifier, found, fragment, q)
            if chances is not None:
                chances[q] = sure.probability.max()
            chosen = sure.listed(best[q][~np.isin(best[q], found.rows)])[0][: answers.shape[1]]
            answers[q, : len(chosen)] = chosen
            if places is not None:
                best_row = int(chosen[0])
                placing = placed(verifier.mapped, fragment, found, chosen.tolist()).get(best_row)
        if places is not None:
            places.append(placing)
        if seconds is not None:
            seconds[q] += process_time() - begun
    return answers


def add_error(errors: PoseErrors, placing: Placed | None, fragment: Fragment, truth: Floats, yaw: float) -> None:
    """Count the error of a fragment's place, which truly is at (3,) ``truth``, metres, its frame turned by ``yaw``."""
    if placing is not None:
        errors.add(placing.of(fragment.origin) - truth, placing.yaw - yaw, placing.covariance)
