"""Replay: the node's work on a recorded run, without ROS. Same input, same bytes out.

What a run is says `semloc_core.sources.Run`; a ground-truth topic, where it has one, is used for scoring only.
Results are written with the stamps of the input.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import BagError, GraphError, MessageError
from semloc_core.graph import Reading, all_unknown
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Located
from semloc_core.replay.traversal_score import Chance, LatencyHistogram, SameStorey, TraversalScore
from semloc_core.sources import (
    GROUND_TRUTH_TOPIC,
    POSE_WITH_COVARIANCE,
    STRING,
    TOLERANCE_S,
    BagWriter,
    Run,
    Truth,
    TruthMatcher,
    decode_string,
    decode_truth,
    encode_pose_with_covariance,
    read_messages,
)
from semloc_core.text import short_repr
from semloc_core.wire import TumWriter, matched_pose, orientation_of, ros_covariance, yaw_of

logger = logging.getLogger(__name__)

_WAITING = 100
"""Answers that wait for their true pose at most."""
MATCHES_TOPIC = "/localiser/matches"
POSE_TOPIC = "/localiser/pose"
ATTRIBUTIONS_TOPIC = "/localiser/attributions"
EVIDENCE_TOPIC = "/localiser/evidence"


Scored = Callable[[wire.PlaceMatches, Truth | None, bool | None], None]
"""Takes an answer, where the robot truly was, and whether the first match is right; None where that is not known."""


@short_repr
@dataclass(frozen=True, eq=False)
class Answer:
    """One answer of a replay, for whoever shows progress."""

    matches: wire.PlaceMatches
    attributions: wire.ClassAttributions | None
    evidence: wire.ClassAttributions | None
    located: Located | None = None


@short_repr
@dataclass(eq=False)
class ReplaySummary:
    """What a replay came to.

    Attributes:
        rows: success by distance travelled (empty without ground truth), see `TraversalScore.rows`.
        updates: updates read; ``counts`` says what became of them, and ``statuses`` of the answers.
        unknown_classes: classes that the map's labelspace lacks -> different objects seen of them.
        all_unknown: why no object said anything to the map, where it knows the class of none; else empty.
        p50_ms, p99_ms: of decoding, applying, locating and explaining one update, wall time.
        listed, calibrated: answers that list places, and those of them whose probabilities are calibrated.
        unscored: answers whose ground truth could not be assigned to a building of the map.
        truth_frames: frames that the ground truth was in.
        said: what was chosen in the run, in lines.
        truths, matched, truth_apart_ns: true poses read, answers that got one, and how far apart at most.

    """

    rows: list[dict[str, object]] = field(default_factory=list)
    updates: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)
    unknown_classes: Counter[str] = field(default_factory=Counter)
    all_unknown: str = ""
    p50_ms: float | None = None
    p99_ms: float | None = None
    listed: int = 0
    calibrated: int = 0
    unscored: int = 0
    truth_frames: set[str] = field(default_factory=set)
    said: list[str] = field(default_factory=list)
    truths: int = 0
    matched: int = 0
    truth_apart_ns: int = 0


def replay(
    run: Path,
    map_: LoadedMap | Localiser,
    config: LocaliserConfig,
    *,
    topic: str | None = None,
    robot: str | None = None,
    truth_topic: str | None = None,
    truth_tolerance_s: float = TOLERANCE_S,
    results: Path | None = None,
    tum: TumWriter | None = None,
    on_answer: Callable[[Answer], None] | None = None,
    on_truth: Callable[[Truth], None] | None = None,
    on_scored: Scored | None = None,
) -> ReplaySummary:
    """Localise along a recorded run.

    Args:
        run: the run, see `semloc_core.sources.Run`.
        map_: the map; or a localiser in one that knows nothing yet, with the same options.
        config: the localiser's options.
        topic, robot, truth_topic: which of the run's topics, see `semloc_core.sources.Run`.
        truth_tolerance_s: how far apart the stamps of an answer and of its ground truth may be.
        results: a bag to write matches, attributions, evidence, poses and the ground truth to.
        tum: takes poses and the ground truth too.
        on_answer: called with each answer.
        on_truth: called with each true pose.
        on_scored: called with each answer, in order, as soon as its true pose is known or none is to be expected.

    Raises:
        BagError: the run can't be read, or has no updates.
        MapUnavailableError: the map's server has been silent for longer than the localiser waits, if it does.

    """
    localiser = map_ if isinstance(map_, Localiser) else Localiser(map_, config)
    left_out = set(localiser.map.all_buildings) - set(localiser.buildings)
    score = TraversalScore(localiser.buildings, sorted(left_out), localiser.same_storey, localiser.chance)
    labels = localiser.live.labels
    reading = labels.reading if labels is not None else Reading(known=localiser.map.model.labelspace)
    recorded = Run(run, topic=topic, robot=robot, truth_topic=truth_topic, reading=reading)
    matcher: TruthMatcher[wire.PlaceMatches] = TruthMatcher(round(truth_tolerance_s * 1e9), _WAITING)
    latency, summary = LatencyHistogram(), ReplaySummary(said=recorded.said)
    with contextlib.ExitStack() as stack:
        writer = stack.enter_context(BagWriter(results)) if results is not None else None
        for message in recorded:
            if message.text is None:
                assert message.truth is not None
                _score(score, matcher.truth(message.truth), on_scored)
                if on_truth is not None:
                    on_truth(message.truth)
                summary.truth_frames.add(message.truth.frame_id)
                building = score.building_of(message.truth.frame_id)
                if tum is not None and building is not None:
                    orientation = getattr(message.truth, "orientation_xyzw", None)
                    tum.truth(building, message.truth.stamp_ns, message.truth.position, orientation)
                if writer is not None and message.raw is not None:
                    writer.write_raw(message.raw._replace(topic=GROUND_TRUTH_TOPIC))
                continue
            summary.updates += 1
            started = time.perf_counter()
            answer = _localise(localiser, message.text, message.received_ns, summary.counts)
            latency.add((time.perf_counter() - started) * 1e3)
            if answer is None:
                continue
            summary.statuses[answer.matches.status] += 1
            summary.listed += bool(answer.matches.matches)
            summary.calibrated += bool(answer.matches.matches) and answer.matches.calibrated
            if on_answer is not None:
                on_answer(answer)
            _score(score, matcher.item(answer.matches.stamp_ns, answer.matches), on_scored)
            if writer is not None:
                writer.write_string(MATCHES_TOPIC, message.received_ns, wire.encode(answer.matches).decode())
                if (pose := _pose(answer.matches, localiser.live.odometry)) is not None:
                    writer.write(POSE_TOPIC, POSE_WITH_COVARIANCE, message.received_ns, pose)
                for name, why in ((ATTRIBUTIONS_TOPIC, answer.attributions), (EVIDENCE_TOPIC, answer.evidence)):
                    if why is not None:
                        writer.write_string(name, message.received_ns, wire.encode(why).decode())
            if tum is not None:
                tum.answer(answer.matches)
    if summary.updates == 0:
        raise BagError(f"expected scene-graph updates in {run} (got none{_of(recorded.topic)})")
    _score(score, matcher.rest(), on_scored)
    summary.truths, summary.matched, summary.truth_apart_ns = matcher.seen, matcher.matched, matcher.largest_ns
    summary.counts.update(recorded.passed_over)
    summary.counts.update(localiser.live.stream.counts)
    summary.unknown_classes = localiser.live.unknown_classes
    graph = localiser.live.stream.graph
    if summary.unknown_classes and graph is not None:
        names = [thing.class_ for thing in graph.objects.values()]
        summary.all_unknown = all_unknown(names, localiser.map.model.labelspace) or ""
    summary.rows, summary.unscored = score.rows(localiser.map.model.encoder.name), score.unscored
    summary.p50_ms, summary.p99_ms = latency.percentile(50), latency.percentile(99)
    return summary


def _of(topic: str | None) -> str:
    return f" on {topic}" if topic else ""


def _pose(matches: wire.PlaceMatches, odometry: wire.Odometry | None) -> bytes | None:
    """The pose of a match as a ROS message; None where there is none, or its stamp fits no ROS time."""
    pose = matched_pose(matches)
    if pose is None or not 0 <= matches.stamp_ns < 2**31 * 1_000_000_000:
        return None
    turn, covariance = orientation_of(pose, odometry), ros_covariance(pose)
    return encode_pose_with_covariance(matches.stamp_ns, matches.frame_id, pose.position, turn, covariance)


def _score(
    score: TraversalScore,
    due: Iterator[tuple[wire.PlaceMatches, Truth | None]],
    on_scored: Scored | None = None,
) -> None:
    for matches, truth in due:
        right = None
        if truth is not None:
            orientation = getattr(truth, "orientation_xyzw", None)
            yaw = None if orientation is None else yaw_of(orientation)
            building = score.building_of(truth.frame_id)
            score.add(matches, truth.position, truth.frame_id, yaw)
            right = None if building is None else any(score.right(matches, building, truth.position)[:1])
        if on_scored is not None:
            on_scored(matches, truth, right)


def _localise(localiser: Localiser, text: str, received_ns: int, counts: Counter[str]) -> Answer | None:
    try:
        result = localiser.update(text)
    except MessageError as error:
        counts["rejected"] += 1
        logger.warning("update at %d ns refused: %s", received_ns, error)
        return None
    except GraphError as error:  # the stream has counted it
        logger.warning("update at %d ns refused: %s", received_ns, error)
        return None
    if result.matches is None:
        return None
    return Answer(result.matches, result.attributions, result.evidence, result.located)


def score_results(
    results: Path,
    buildings: list[str],
    topic: str = MATCHES_TOPIC,
    same_storey: SameStorey | None = None,
    chance: Chance | None = None,
) -> list[dict[str, object]]:
    """Score a recorded bag of answers (a replay's, or the node's as recorded with its ground truth).

    Args:
        results: the bag.
        buildings: names of the map's buildings.
        topic: where the matches are.
        same_storey, chance: of the map, as for `TraversalScore`.

    """
    score = TraversalScore(buildings, same_storey=same_storey, chance=chance)
    matcher: TruthMatcher[wire.PlaceMatches] = TruthMatcher(waiting=_WAITING)
    for message in read_messages(results, topics=[topic, GROUND_TRUTH_TOPIC]):
        if message.topic == GROUND_TRUTH_TOPIC:
            _score(score, matcher.truth(decode_truth(message)))
        else:
            answer = wire.decode(decode_string(message.data), wire.PlaceMatches)
            _score(score, matcher.item(answer.stamp_ns, answer))
    _score(score, matcher.rest())
    return score.rows("recorded")


def answers(results: Path, topic: str = MATCHES_TOPIC) -> Iterator[wire.PlaceMatches]:
    """The matches in a results bag, in order."""
    for message in read_messages(results, topics={topic: STRING}):
        yield wire.decode(decode_string(message.data), wire.PlaceMatches)
