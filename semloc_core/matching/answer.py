"""A question to the localiser, its answer, and what one update led to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Batch, Encoded
from semloc_core.graph import Outcome
from semloc_core.map_database import LoadedMap
from semloc_core.matching.layout.evidence import Evidence
from semloc_core.matching.layout.pose.placed import NO_YAW, Placed
from semloc_core.matching.posterior import Ranking
from semloc_core.text import short_repr
from semloc_core.wire import ClassAttributions, Match, PlaceMatches, Pose, Transform

DIGITS, FARTHEST_M = 6, 1e9
"""Of poses: as a message has them. Beyond, they hang on the order in which a product was summed."""


@short_repr
@dataclass(frozen=True, eq=False)
class Query:
    """One question: where is ``place``, in the graph as it was after update ``seq``? Nothing in it changes later.

    ``batch`` and ``encoded`` are None where there was nothing to embed; ``reason`` then says why.
    """

    stamp_ns: int
    seq: int
    place: str | None
    batch: Batch | None = None
    encoded: Encoded | None = None
    class_names: tuple[str, ...] = ()
    reason: str = ""

    def because(self, reason: str) -> Query:
        """The same question, which has no answer for this reason."""
        return Query(self.stamp_ns, self.seq, self.place, reason=reason)


@short_repr
@dataclass(frozen=True, eq=False)
class Located:
    """An answer: the message to publish, and what `Localiser.explain` needs to say why.

    ``evidence`` is what the test by layout rests on at the best row; None where that was not tested.
    """

    query: Query
    matches: PlaceMatches
    map: LoadedMap
    best_row: int | None = None
    evidence: Evidence | None = None


@short_repr
@dataclass(frozen=True, eq=False)
class Localisation:
    """What one update led to.

    Attributes:
        outcome: what became of the update.
        located: the answer; None where the update was dropped as a repeat.
        attributions: what the encoder looked at, or another explainer says; None where none were due.
        evidence: what the decision rests on; None where nothing was put to the test.

    """

    outcome: Outcome
    located: Located | None = None
    attributions: ClassAttributions | None = None
    evidence: ClassAttributions | None = None

    @property
    def matches(self) -> PlaceMatches | None:
        """The message to publish."""
        return self.located.matches if self.located is not None else None


@short_repr
@dataclass(frozen=True)
class ServerState:
    """How the server that keeps a map does, as far as this robot knows.

    Args:
        answers: whether it answered when it was last asked.
        line: one sentence.
        values: figures, as text.

    """

    answers: bool
    line: str
    values: dict[str, str]


def matches_of(
    loaded: LoadedMap,
    rows: NDArray[np.int64],
    ranking: Ranking,
    similarity: NDArray[np.float32],
    poses: Mapping[int, Pose] | None = None,
) -> list[Match]:
    """Rows of a map as a message lists them.

    Args:
        loaded: the map.
        rows: (K,) best first.
        ranking: has their probabilities.
        similarity: (M,) of the query to all places of the map.
        poses: by row, where they are known.

    """
    known = poses or {}
    return [
        Match(
            rank=rank,
            map=loaded.buildings[int(loaded.building_index[row])],
            place=loaded.place_ids[row],
            position=tuple(loaded.positions[row].tolist()),
            similarity=float(similarity[row]),
            probability=ranking.probability[row],
            pose=known.get(row),
        )
        for rank, row in enumerate(rows.tolist(), 1)
    ]


def pose_in(placed: Placed, point: NDArray[np.float64], yaw: float | None) -> Pose:
    """The pose of a robot in the building that its frame is placed in.

    Args:
        placed: the frame.
        point: (3,) where the robot is in it, metres.
        yaw: its heading there, radians; None where that is not known.

    """
    covariance = placed.covariance_at(point)
    heading = None if yaw is None else math.remainder(placed.yaw + yaw, 2 * math.pi)
    if heading is None:
        covariance[3], covariance[:, 3] = 0.0, 0.0
        covariance[3, 3] = NO_YAW
    # A heading of which nothing is known has this variance: no greater one means anything.
    elif covariance[3, 3] > NO_YAW:
        shrink = math.sqrt(NO_YAW / covariance[3, 3])
        covariance[3] *= shrink
        covariance[:, 3] *= shrink
    x, y, z = _rounded(np.clip(placed.of(point), -FARTHEST_M, FARTHEST_M))
    return Pose((x, y, z), None if heading is None else round(heading, DIGITS), _rounded(covariance))


def transform_of(placed: Placed) -> Transform:
    """The same frame as a message has it."""
    x, y, z = _rounded(np.clip(placed.translation, -FARTHEST_M, FARTHEST_M))
    return Transform((x, y, z), round(math.remainder(placed.yaw, 2 * math.pi), DIGITS))


def _rounded(values: NDArray[np.float64]) -> list[float]:
    # Twice: else what lies between two digits, as round figures do, goes up or down by its last bit.
    found: list[float] = (np.round(np.round(values, DIGITS + 3), DIGITS) + 0.0).ravel().tolist()
    return found
