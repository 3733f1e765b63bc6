"""A question to the localiser, its answer, and what one update led to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Query
from semloc_core.graph import Outcome
from semloc_core.map_database import LoadedMap, frame_of
from semloc_core.matching.layout.evidence import Evidence
from semloc_core.matching.layout.pose.placed import NO_YAW, Placed
from semloc_core.matching.posterior import Ranking, Similarities, status_of
from semloc_core.matching.reranker import Reranked, Reranker
from semloc_core.text import short_repr
from semloc_core.wire import ClassAttributions, MapInfo, Match, ModelInfo, PlaceMatches, Pose, Status, Transform

DIGITS, FARTHEST_M = 6, 1e9
"""Of poses: as a message has them. Beyond, they hang on the order in which a product was summed."""


@short_repr
@dataclass(frozen=True, eq=False)
class Located:
    """An answer: the message to publish, and what `Localiser.explain` needs to say why.

    ``evidence`` is what the test by layout rests on at the best row; None where nothing was put to the test.
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


@short_repr
@dataclass(frozen=True, eq=False)
class Reply:
    """The answer to a question, before it is known.

    Args:
        query: the question.
        map: answers it.
        config: of the localiser.
        map_info: what is said of the map; None while it is not known.
        model_info: the same of its model.

    """

    query: Query
    map: LoadedMap
    config: LocaliserConfig
    map_info: MapInfo | None
    model_info: ModelInfo | None

    @property
    def n_places(self) -> int:
        """Of the whole map."""
        return 0 if self.map_info is None else self.map_info.places

    def nothing(self, status: Status) -> Located:
        """There is no match."""
        return Located(self.query, self._message(status), self.map)

    def answer(
        self,
        raw: Ranking,
        similarity: Similarities,
        stands: tuple[NDArray[np.float64], float | None],
        reranker: Reranker | None,
        tested: Reranked | None,
    ) -> Located:
        """Say how likely which places are.

        Args:
            raw: what the search makes of it.
            similarity: (M,) of the query to all places of the map.
            stands: (3,) where the robot is in its frame, metres, and its heading there where that is known.
            reranker: puts answers to the test; None where that is not asked for.
            tested: what came of it; None where nothing fitted.

        """
        ranking = tested.ranking if tested is not None else raw if reranker is None else raw.doubted()
        best = int(ranking.rows[0])
        status = status_of(ranking.probability[best], self.config.accept_probability, ranking.in_map)
        rivals = ranking.rivals()[: 0 if status == "match" else self.config.top_n]
        places: Mapping[int, Placed] = {}
        if reranker is not None and tested is not None:
            places = reranker.placed(tested, [*ranking.rows.tolist(), *rivals.tolist()])
        # Places near one another are of one answer.
        once = {id(place): place for place in places.values()}
        pose_of = {key: pose_in(place, *stands) for key, place in once.items()}
        poses = {row: pose_of[id(place)] for row, place in places.items()}
        matches = matches_of(self.map, ranking.rows, ranking, similarity, poses)
        message = self._message(
            status,
            matches=matches,
            rivals=matches_of(self.map, rivals, ranking, similarity, poses),
            raw_matches=matches_of(self.map, raw.rows, raw, similarity) if ranking is not raw else None,
            calibrated=reranker is not None,
            transform=transform_of(places[best]) if best in places else None,
        )
        evidence = reranker.evidence(tested, best) if reranker is not None and tested is not None else None
        return Located(self.query, message, self.map, best, evidence)

    def _message(
        self,
        status: Status,
        matches: Sequence[Match] = (),
        rivals: Sequence[Match] = (),
        raw_matches: list[Match] | None = None,
        calibrated: bool = False,
        transform: Transform | None = None,
    ) -> PlaceMatches:
        building = matches[0].map if matches else None
        return PlaceMatches(
            schema="semloc/place_matches/1",
            stamp_ns=self.query.stamp_ns,
            frame_id=frame_of(self.config.frame_id, self.map.all_buildings, building),
            seq=self.query.seq,
            query_place=self.query.place,
            status=status,
            matches=list(matches),
            raw_matches=raw_matches,
            rivals=list(rivals),
            map=self.map_info,
            model=self.model_info,
            calibrated=calibrated,
            latency_ms=None,
            transform=transform,
        )


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
