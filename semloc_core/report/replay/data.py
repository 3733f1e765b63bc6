"""A results bag, read once as a stream, into what the report draws: thinned series, counts, and scored rows."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import BagError, MapError
from semloc_core.map_database import LoadedMap
from semloc_core.metrics import Row
from semloc_core.replay import LatencyHistogram, TraversalScore
from semloc_core.report.replay.thinned import Thinned
from semloc_core.sources import (
    GROUND_TRUTH_TOPIC,
    TOLERANCE_S,
    BagMessage,
    BagReader,
    Run,
    Truth,
    TruthMatcher,
    decode_string,
    decode_truth,
)
from semloc_core.text import short_repr

T = TypeVar("T")
POINTS = 2000
"""Answers drawn at most; a longer run is thinned evenly."""
SHARES = 500
"""Attributions drawn at most."""
_WAITING = 100
"""Answers that wait for their true position at most."""


@short_repr
@dataclass(frozen=True)
class Point:
    """One answer, as drawn.

    Attributes:
        seconds: since the bag's first answer.
        status: of the answer.
        match: the top match, or None.
        truth: building and position (m) where the robot truly was, or None where it is not known.
        right: whether the top match is right (an answer without one is wrong); None without truth.
        latency_ms: where the answer brings it.

    """

    seconds: float
    status: str
    match: wire.Match | None
    truth: tuple[str, wire.Position] | None
    right: bool | None
    latency_ms: float | None


@short_repr
@dataclass(frozen=True)
class Attributed:
    """Shares of classes in one answer (they sum to 1), and how many objects of each class had a part in it."""

    seconds: float
    classes: dict[str, float]
    instances: dict[str, int]


@short_repr
@dataclass
class WrongPlace:
    """A place of the map that was the top match where it should not have been.

    Attributes:
        position: of the place, metres.
        count: how often.
        elsewhere: how often of these the robot was in another building.
        error_m: sum of the distances to the truth where it was in the same one.

    """

    position: wire.Position
    count: int = 0
    elsewhere: int = 0
    error_m: float = 0.0

    @property
    def mean_error_m(self) -> float | None:
        """Mean distance to the truth, within the building; None where the robot never was in it."""
        same = self.count - self.elsewhere
        return self.error_m / same if same else None


@short_repr
@dataclass
class ReplayData:
    """What a replay's report shows; every list is bounded, whatever the bag's length.

    Attributes:
        points, shares: thinned series of answers and attributions, by time.
        best: the clearest of the answers with attributions (right if any is, then by probability and similarity).
        rows: success by distance travelled, see `TraversalScore.rows`; empty without ground truth.
        answers: how many there were in all; ``statuses`` of them.
        wrong: (building, place) -> how often a wrong top match fell on it, and how far off it was.
        unscored: answers whose ground truth names no building of the map.
        p50_ms, p99_ms: latency, where the answers bring it.
        calibrated: whether the probabilities are.

    """

    points: Thinned[Point] = field(default_factory=lambda: Thinned(POINTS))
    shares: Thinned[Attributed] = field(default_factory=lambda: Thinned(SHARES))
    best: tuple[Point, Attributed] | None = None
    rows: list[Row] = field(default_factory=list)
    answers: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    wrong: dict[tuple[str, str], WrongPlace] = field(default_factory=dict)
    unscored: int = 0
    p50_ms: float | None = None
    p99_ms: float | None = None
    calibrated: bool = False

    @property
    def has_truth(self) -> bool:
        """Whether any answer could be scored."""
        return bool(self.rows)


def read_results(
    results: Path,
    loaded: LoadedMap,
    *,
    run: Path | None = None,
    node: str = "/localiser",
    topic: str | None = None,
    robot: str | None = None,
    truth_tolerance_s: float = TOLERANCE_S,
) -> ReplayData:
    """Read a bag of answers: a replay's, or the node's as recorded.

    Args:
        results: the bag.
        loaded: the map that answered.
        run: a bag to take the ground truth from, in place of the results.
        topic, robot: which of the run's topics, see `semloc_core.sources.run.Run`.
        truth_tolerance_s: how far apart the stamps of an answer and of its ground truth may be.
        node: name of the node; its answers are on ``<node>/matches`` and ``<node>/attributions``.

    Raises:
        BagError: a bag can't be read, or has no answers.
        MapError: the answers come from another map.
        MessageError: a message is not what its schema says.

    """
    gathering = _Gathering(loaded, truth_tolerance_s)
    matches, attributions = f"{node}/matches", f"{node}/attributions"
    own = [] if run is not None else [GROUND_TRUTH_TOPIC]
    reader = BagReader(results, [matches, attributions, *own])
    messages: Iterator[BagMessage] = iter(reader)
    if run is not None:
        recorded = Run(run, topic=topic, robot=robot, truth_only=True)
        truths = (m.raw._replace(topic=GROUND_TRUTH_TOPIC) for m in recorded if m.raw is not None)
        messages = heapq.merge(messages, truths, key=attrgetter("stamp_ns"))
    for message in messages:
        if message.topic == GROUND_TRUTH_TOPIC:
            gathering.truth(decode_truth(message))
        elif message.topic == matches:
            gathering.answer(message.stamp_ns, wire.decode(decode_string(message.data), wire.PlaceMatches))
        else:
            gathering.attributions(wire.decode(decode_string(message.data), wire.ClassAttributions))
    if gathering.start_ns is None:
        topics = ", ".join(sorted(reader.types)) or "nothing"
        raise BagError(f"expected answers on {matches} in {results} (got {topics})")
    return gathering.finish()


def confused_places(wrong: Mapping[tuple[str, str], WrongPlace]) -> list[tuple[tuple[str, str], WrongPlace]]:
    """Where wrong answers fell, most often first; a place takes in those within the match radius: they are one answer.

    Args:
        wrong: (building, place) -> what fell on it; unchanged.

    """
    spots: list[tuple[tuple[str, str], WrongPlace]] = []
    for (building, place), found in sorted(wrong.items(), key=lambda item: (-item[1].count, item[0])):
        for (other, _), spot in spots:
            if other == building and np.linalg.norm(np.subtract(spot.position, found.position)) <= MATCH_RADIUS_M:
                spot.count += found.count
                spot.elsewhere += found.elsewhere
                spot.error_m += found.error_m
                break
        else:
            spots.append(((building, place), replace(found)))
    return sorted(spots, key=lambda item: (-item[1].count, item[0]))


class _Gathering:
    """Pairs answers with truth and attributions by stamp, in the order of the answers."""

    def __init__(self, loaded: LoadedMap, tolerance_s: float = TOLERANCE_S) -> None:
        self.start_ns: int | None = None
        self._map = loaded
        self._data = ReplayData()
        self._score = TraversalScore(loaded.buildings, same_storey=loaded.same_storey, chance=loaded.chance)
        self._latency = LatencyHistogram()
        self._matcher: TruthMatcher[tuple[float, wire.PlaceMatches]] = TruthMatcher(round(tolerance_s * 1e9), _WAITING)
        self._attributed: dict[int, wire.ClassAttributions] = {}
        self._points: dict[int, Point] = {}

    def answer(self, received_ns: int, answer: wire.PlaceMatches) -> None:
        if answer.map is not None and answer.map.hash != self._map.hash:
            raise MapError(
                f"expected answers from the map {self._map.name!r} {self._map.hash[:12]} "
                f"(got answers from {answer.map.name!r} {answer.map.hash[:12]})"
            )
        self.start_ns = received_ns if self.start_ns is None else self.start_ns
        self._data.answers += 1
        self._data.statuses[answer.status] += 1
        self._data.calibrated |= answer.calibrated
        if answer.latency_ms is not None:
            self._latency.add(answer.latency_ms)
        item = ((received_ns - self.start_ns) / 1e9, answer)
        self._take_all(self._matcher.item(answer.stamp_ns, item))

    def truth(self, truth: Truth) -> None:
        self._take_all(self._matcher.truth(truth))

    def attributions(self, message: wire.ClassAttributions) -> None:
        self._attributed[message.stamp_ns] = message
        _keep_latest(self._attributed)
        self._join(message.stamp_ns)

    def finish(self) -> ReplayData:
        self._take_all(self._matcher.rest())
        self._data.rows = cast("list[Row]", self._score.rows(self._map.model.encoder.name))
        self._data.unscored = self._score.unscored
        self._data.p50_ms, self._data.p99_ms = self._latency.percentile(50), self._latency.percentile(99)
        return self._data

    def _take_all(self, due: Iterator[tuple[tuple[float, wire.PlaceMatches], Truth | None]]) -> None:
        for (seconds, answer), truth in due:
            self._take(seconds, answer, truth)

    def _take(self, seconds: float, answer: wire.PlaceMatches, stamped: Truth | None) -> None:
        top = answer.matches[0] if answer.matches else None
        truth, right = None, None
        if stamped is not None and self._score.add(answer, stamped.position, stamped.frame_id):
            building = self._score.building_of(stamped.frame_id)
            assert building is not None
            truth, right = (building, stamped.position), any(self._score.right(answer, building, stamped.position)[:1])
            if top is not None and not right:
                self._count_wrong(top, building, stamped.position)
        point = Point(seconds, answer.status, top, truth, right, answer.latency_ms)
        self._data.points.add(point)
        self._points[answer.stamp_ns] = point
        _keep_latest(self._points)
        self._join(answer.stamp_ns)

    def _count_wrong(self, match: wire.Match, building: str, truth: wire.Position) -> None:
        place = self._data.wrong.setdefault((match.map, match.place), WrongPlace(match.position))
        place.count += 1
        if match.map != building:
            place.elsewhere += 1
        else:
            place.error_m += float(np.linalg.norm(np.subtract(match.position, truth)))

    def _join(self, stamp_ns: int) -> None:
        """Put an answer and its attributions together, whichever came first."""
        if stamp_ns not in self._points or stamp_ns not in self._attributed:
            return
        point, message = self._points.pop(stamp_ns), self._attributed.pop(stamp_ns)
        shares = Attributed(
            point.seconds,
            {c.class_: c.share for c in message.classes},
            {c.class_: c.instances for c in message.classes},
        )
        self._data.shares.add(shares)
        if point.match is not None and (self._data.best is None or _clarity(point) > _clarity(self._data.best[0])):
            self._data.best = (point, shares)


def _clarity(point: Point) -> tuple[bool, float, float]:
    if point.match is None:
        return False, -1.0, -1.0
    return bool(point.right), round(point.match.probability, 2), point.match.similarity


def _keep_latest(waiting: dict[int, T]) -> None:
    if len(waiting) > _WAITING:
        del waiting[next(iter(waiting))]
