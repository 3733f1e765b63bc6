"""A results bag, read once as a stream, into what a page plays."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path

from semloc_core import wire
from semloc_core.errors import BagError, GraphError, MessageError, SemlocError
from semloc_core.graph import Reading
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.metrics import Progress, no_progress
from semloc_core.report.replay.answered import candidates_of, weigh
from semloc_core.report.replay.frames import Candidate, Frame
from semloc_core.report.replay.gathering import FRAMES, Gathering, ReplayData
from semloc_core.sources import GROUND_TRUTH_TOPIC, TOLERANCE_S, BagMessage, BagReader, Run, decode_string, decode_truth

_SAME = 0.005
"""Probabilities this near are one: of answers recorded on another machine, too."""


def read_results(
    results: Path,
    loaded: LoadedMap,
    *,
    run: Path | None = None,
    node: str = "/localiser",
    topic: str | None = None,
    robot: str | None = None,
    truth_tolerance_s: float = TOLERANCE_S,
    reading: Reading | None = None,
    progress: Progress = no_progress,
) -> ReplayData:
    """Read a bag of answers: a replay's, or the node's as recorded.

    Args:
        results: the bag.
        loaded: the map that answered.
        run: the run that was answered; the ground truth is taken from it, and the test is taken apart at the rivals of
            each answer, if it has updates. None: the results' own, where they have any.
        topic, robot: which of the run's topics, see `semloc_core.sources.Run`.
        truth_tolerance_s: how far apart the stamps of an answer and of its ground truth may be.
        node: name of the node; its answers are on ``<node>/matches``, what they rest on on ``<node>/evidence``.
        reading: how the run's labels are read; None leaves them to the map.
        progress: called with answers done and in all, while the run is gone through.

    Raises:
        BagError: a bag can't be read, or has no answers.
        MapError: the answers come from another map.
        MessageError: a message is not what its schema says.

    """
    gathering = Gathering(loaded, truth_tolerance_s, FRAMES)
    matches, said = f"{node}/matches", [f"{node}/attributions", f"{node}/evidence"]
    own = [] if run is not None else [GROUND_TRUTH_TOPIC]
    reader = BagReader(results, [matches, *said, *own])
    messages: Iterator[BagMessage] = iter(reader)
    updates = _with_updates(run or results, topic, robot)
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
            gathering.said(wire.decode(decode_string(message.data), wire.ClassAttributions))
    if not gathering.data.answers:
        topics = ", ".join(sorted(reader.types)) or "nothing"
        raise BagError(f"expected answers on {matches} in {results} (got {topics}; semloc replay RUN -o makes such)")
    data = gathering.finish()
    if updates is not None:
        known = reading or Reading(known=loaded.model.labelspace)
        _weigh_all(data, loaded, Run(updates, topic=topic, robot=robot, reading=known), reading, progress)
    return data


def has_answers(bag: Path, node: str = "/localiser") -> bool:
    """Whether a bag holds a node's answers, and not only a run."""
    try:
        return next(iter(BagReader(bag, [f"{node}/matches"])), None) is not None
    except BagError:
        return False


def _with_updates(bag: Path, topic: str | None, robot: str | None) -> Path | None:
    """The bag if it has updates; a bag of truths alone, or of answers, has none."""
    try:
        Run(bag, topic=topic, robot=robot)
    except SemlocError:
        return None
    return bag


def _weigh_all(
    data: ReplayData,
    loaded: LoadedMap,
    recorded: Run,
    reading: Reading | None,
    progress: Progress,
) -> None:
    """Go through the run again, and ask the core at each frame's update what speaks for each candidate."""
    waiting: dict[tuple[int, int], list[Frame]] = {}
    for frame in data.frames:
        waiting.setdefault((frame.stamp_ns, frame.seq), []).append(frame)
    localiser, done = Localiser(loaded, said=reading), 0
    for message in recorded:
        if message.text is None:
            continue
        try:
            update = wire.decode_update(message.text, localiser.config.max_update_bytes)
            localiser.apply(update)
        except (MessageError, GraphError):  # refused when it was answered, too
            continue
        frames = waiting.pop((update.stamp_ns, update.seq), [])
        located = localiser.locate() if frames else None
        for frame in frames:
            assert located is not None
            data.run = True
            data.weighed += not _same_answer(frame, candidates_of(located.matches, data.buildings))
            done += 1
            weigh(frame, located, data.buildings)
            progress(done, len(data.frames), "")


def _same_answer(frame: Frame, alone: Sequence[Candidate]) -> bool:
    """Whether a frame's best match is that of the answer by itself, and as likely but for rounding."""
    if not frame.candidates or not alone:
        return not frame.candidates and not alone
    said, own = frame.candidates[0], alone[0]
    return (said.map, said.place) == (own.map, own.place) and abs(said.probability - own.probability) <= _SAME
