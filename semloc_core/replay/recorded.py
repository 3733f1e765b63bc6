"""Replay: the node's work on a recorded run, without ROS. Same input, same bytes out.

A run is a bag with scene-graph updates as ``std_msgs/msg/String``; a ground-truth topic, where it has one, is used
for scoring only. Results are written with the stamps of the input.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import BagError, GraphError, MessageError
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.replay.traversal_score import LatencyHistogram, TraversalScore
from semloc_core.sources import (
    GROUND_TRUTH_TOPIC,
    POINT_STAMPED,
    STRING,
    BagMessage,
    BagWriter,
    decode_point,
    decode_string,
    read_messages,
)

logger = logging.getLogger(__name__)

T = TypeVar("T")
_WAITING = 100
"""Answers, or true positions, that wait for their counterpart at most."""
MATCHES_TOPIC = "/localiser/matches"
ATTRIBUTIONS_TOPIC = "/localiser/attributions"


@dataclass(frozen=True, eq=False)
class Answer:
    """One answer of a replay, for whoever shows progress."""

    matches: wire.PlaceMatches
    attributions: wire.ClassAttributions | None


@dataclass(eq=False)
class ReplaySummary:
    """What a replay came to.

    Attributes:
        rows: success by distance travelled (empty without ground truth), see `TraversalScore.rows`.
        updates: updates read; ``counts`` says what became of them, and ``statuses`` of the answers.
        unknown_classes: classes that the map's labelspace lacks -> objects seen of them.
        p50_ms, p99_ms: of decoding, applying, locating and explaining one update, wall time.
        listed, calibrated: answers that list places, and those of them whose probabilities are calibrated.
        unscored: answers whose ground truth could not be assigned to a building of the map.
        truth_frames: frames that the ground truth was in.

    """

    rows: list[dict[str, object]] = field(default_factory=list)
    updates: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)
    unknown_classes: Counter[str] = field(default_factory=Counter)
    p50_ms: float | None = None
    p99_ms: float | None = None
    listed: int = 0
    calibrated: int = 0
    unscored: int = 0
    truth_frames: set[str] = field(default_factory=set)


class _Truths:
    """Pairs answers with ground truth by stamp, whichever comes first; keeps only the latest few."""

    def __init__(self, score: TraversalScore) -> None:
        self._score = score
        self._answers: dict[int, wire.PlaceMatches] = {}
        self._truths: dict[int, tuple[wire.Position, str]] = {}

    def answer(self, matches: wire.PlaceMatches) -> None:
        truth = self._truths.pop(matches.stamp_ns, None)
        if truth is not None:
            self._score.add(matches, *truth)
        else:
            self._answers[matches.stamp_ns] = matches
            _trim(self._answers)

    def truth(self, stamp_ns: int, position: wire.Position, frame_id: str) -> None:
        matches = self._answers.pop(stamp_ns, None)
        if matches is not None:
            self._score.add(matches, position, frame_id)
        else:
            self._truths[stamp_ns] = (position, frame_id)
            _trim(self._truths)


def _trim(waiting: dict[int, T]) -> None:
    if len(waiting) > _WAITING:
        del waiting[next(iter(waiting))]


def replay(
    run: Path,
    map_: LoadedMap | Localiser,
    config: LocaliserConfig,
    *,
    topic: str = "/scene_graph",
    results: Path | None = None,
    on_answer: Callable[[Answer], None] | None = None,
) -> ReplaySummary:
    """Localise along a recorded run.

    Args:
        run: the bag (a rosbag2 folder or a single .mcap).
        map_: the map; or a localiser in one that knows nothing yet, with the same options.
        config: the localiser's options.
        topic: where the updates are.
        results: a bag to write matches, attributions and the ground truth to.
        on_answer: called with each answer.

    Raises:
        BagError: the run can't be read, or has no updates on ``topic``.
        MapUnavailableError: the map's server has been silent for longer than the localiser waits, if it does.

    """
    localiser = map_ if isinstance(map_, Localiser) else Localiser(map_, config)
    left_out = set(localiser.map.all_buildings) - set(localiser.buildings)
    score = TraversalScore(localiser.buildings, sorted(left_out))
    truths, latency, summary = _Truths(score), LatencyHistogram(), ReplaySummary()
    with contextlib.ExitStack() as stack:
        writer = stack.enter_context(BagWriter(results)) if results is not None else None
        for message in read_messages(run, topics={topic: STRING, GROUND_TRUTH_TOPIC: POINT_STAMPED}):
            if message.topic == GROUND_TRUTH_TOPIC:
                truth = decode_point(message.data)
                truths.truth(truth.stamp_ns, truth.position, truth.frame_id)
                summary.truth_frames.add(truth.frame_id)
                if writer is not None:
                    writer.write_raw(message)
                continue
            summary.updates += 1
            started = time.perf_counter()
            answer = _localise(localiser, message, summary.counts)
            latency.add((time.perf_counter() - started) * 1e3)
            if answer is None:
                continue
            summary.statuses[answer.matches.status] += 1
            summary.listed += bool(answer.matches.matches)
            summary.calibrated += bool(answer.matches.matches) and answer.matches.calibrated
            truths.answer(answer.matches)
            if writer is not None:
                writer.write_string(MATCHES_TOPIC, message.stamp_ns, wire.encode(answer.matches).decode())
                if answer.attributions is not None:
                    text = wire.encode(answer.attributions).decode()
                    writer.write_string(ATTRIBUTIONS_TOPIC, message.stamp_ns, text)
            if on_answer is not None:
                on_answer(answer)
    if summary.updates == 0:
        raise BagError(f"expected scene-graph updates on {topic} in {run} (got none)")
    summary.counts.update(localiser.stream.counts)
    summary.unknown_classes = localiser.unknown_classes
    summary.rows, summary.unscored = score.rows(localiser.map.model.encoder.name), score.unscored
    summary.p50_ms, summary.p99_ms = latency.percentile(50), latency.percentile(99)
    return summary


def _localise(localiser: Localiser, message: BagMessage, counts: Counter[str]) -> Answer | None:
    try:
        result = localiser.update(decode_string(message.data))
    except MessageError as error:
        counts["rejected"] += 1
        logger.warning("update at %d ns refused: %s", message.stamp_ns, error)
        return None
    except GraphError as error:  # the stream has counted it
        logger.warning("update at %d ns refused: %s", message.stamp_ns, error)
        return None
    if result.matches is None:
        return None
    return Answer(result.matches, result.attributions)


def score_results(results: Path, buildings: list[str], topic: str = MATCHES_TOPIC) -> list[dict[str, object]]:
    """Score a recorded bag of answers (a replay's, or the node's as recorded with its ground truth).

    Args:
        results: the bag.
        buildings: names of the map's buildings.
        topic: where the matches are.

    """
    score = TraversalScore(buildings)
    truths = _Truths(score)
    for message in read_messages(results, topics={topic: STRING, GROUND_TRUTH_TOPIC: POINT_STAMPED}):
        if message.topic == GROUND_TRUTH_TOPIC:
            truth = decode_point(message.data)
            truths.truth(truth.stamp_ns, truth.position, truth.frame_id)
        else:
            truths.answer(wire.decode(decode_string(message.data), wire.PlaceMatches))
    return score.rows("recorded")


def answers(results: Path, topic: str = MATCHES_TOPIC) -> Iterator[wire.PlaceMatches]:
    """The matches in a results bag, in order."""
    for message in read_messages(results, topics={topic: STRING}):
        yield wire.decode(decode_string(message.data), wire.PlaceMatches)
