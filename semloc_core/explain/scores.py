"""Scores of objects, and their sums by semantic class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.text import short_repr
from semloc_core.wire import ClassAttribution, ObjectAttribution

NOISE = 1e-6  # the wire keeps six decimals


@short_repr
@dataclass(frozen=True, eq=False)
class ObjectScores:
    """What an explainer says of the objects around one query place.

    Args:
        method: the explainer's name.
        ids: O object ids.
        classes: O class names.
        scores: (O,) float64, signed; larger means more important for the similarity.
        unattributed: what the method gave to no object (attention kept by places), or None where it has no meaning.
        completeness_gap: what the scores should sum to, minus their sum; None where that has no meaning.
        standard_error: (O,) float64 of scores that were sampled, or None.

    """

    method: str
    ids: tuple[str, ...]
    classes: tuple[str, ...]
    scores: NDArray[np.float64]
    unattributed: float | None = None
    completeness_gap: float | None = None
    standard_error: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        o = len(self.ids)
        assert len(self.classes) == o, (len(self.classes), o)
        assert self.scores.shape == (o,), self.scores.shape
        assert self.standard_error is None or self.standard_error.shape == (o,), self.standard_error


def class_scores(scores: ObjectScores) -> list[ClassAttribution]:
    """Sum by class; shares are of the summed magnitude, so they are ≥ 0 and sum to 1, by falling share.

    Where every score is zero the shares are equal: nothing speaks for one class before another. So are they where
    the scores are below what a message can carry: there (a query at a place of the map itself has similarity 1 and no
    gradient) they are rounding errors.
    """
    total: dict[str, float] = {}
    instances: dict[str, int] = {}
    for name, score in zip(scores.classes, scores.scores.tolist(), strict=True):
        total[name] = total.get(name, 0.0) + score
        instances[name] = instances.get(name, 0) + 1
    return by_share(total, instances)


def by_share(total: Mapping[str, float], instances: Mapping[str, int]) -> list[ClassAttribution]:
    """Classes by falling share of the summed magnitude, then by name; see `class_scores`.

    Args:
        total: class -> signed score.
        instances: class -> how many objects, of the same classes.

    """
    magnitude = sum(abs(value) for value in total.values())
    shares: Mapping[str, float] = {
        name: abs(value) / magnitude if magnitude > NOISE else 1 / len(total) for name, value in total.items()
    }
    names = sorted(total, key=lambda name: (-shares[name], name))
    return [
        ClassAttribution(class_=name, score=total[name], share=shares[name], instances=instances[name])
        for name in names
    ]


def object_scores(scores: ObjectScores) -> list[ObjectAttribution]:
    """One entry an object, by falling score, then by id."""
    order: Sequence[int] = sorted(range(len(scores.ids)), key=lambda i: (-float(scores.scores[i]), scores.ids[i]))
    return [ObjectAttribution(id=scores.ids[i], class_=scores.classes[i], score=float(scores.scores[i])) for i in order]
