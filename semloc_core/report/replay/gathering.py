"""Answers, what was said of them, and where the robot truly was, gathered into what a page plays; and scored rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeVar, cast

import numpy as np

from semloc_core import wire
from semloc_core.errors import MapError
from semloc_core.explain import LAYOUT
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Located
from semloc_core.metrics import Row
from semloc_core.replay import LatencyHistogram, TraversalScore
from semloc_core.report.replay.answered import candidates_of, look, see, weigh
from semloc_core.report.replay.frames import Buildings, Frame
from semloc_core.report.replay.frames import Truth as TruePose
from semloc_core.report.replay.thinned import Thinned
from semloc_core.sources import TOLERANCE_S, Truth, TruthMatcher
from semloc_core.text import short_repr
from semloc_core.wire import yaw_of

T = TypeVar("T")
FRAMES = 7500
"""Answers shown at most, an hour at 2 Hz and a little; a longer run is thinned evenly."""
_WAITING = 100
"""Answers that wait for their true position at most."""


@short_repr
@dataclass
class ReplayData:
    """What a replay's page shows; every list is bounded, whatever the bag's length.

    Attributes:
        buildings: of the map.
        frames: thinned series of answers, by time.
        rows: success by distance travelled, see `TraversalScore.rows`; empty without ground truth.
        answers: how many there were in all; ``statuses`` of them.
        unscored: answers whose ground truth names no building of the map.
        p50_ms, p99_ms: latency, where the answers bring it.
        calibrated: whether the probabilities are.
        run: whether the run was at hand: what was seen, and what speaks for the rivals, is known.
        weighed: shown answers that the run and the map, asked at that moment alone, would not have given: earlier ones
            weighed in, or other options were set. Only where the run was at hand.

    """

    buildings: Buildings
    frames: Thinned[Frame] = field(default_factory=lambda: Thinned(FRAMES))
    rows: list[Row] = field(default_factory=list)
    answers: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    unscored: int = 0
    p50_ms: float | None = None
    p99_ms: float | None = None
    calibrated: bool = False
    run: bool = False
    weighed: int = 0

    @property
    def best(self) -> Frame | None:
        """The clearest of the answers that say why: right if any is, then by probability and similarity."""
        told = [of for of in self.frames if of.candidates and (of.because or of.attention)]
        return max(told, key=_clarity, default=None)


def _clarity(frame: Frame) -> tuple[bool, float, float]:
    best = frame.candidates[0]
    return bool(frame.right), round(best.probability, 2), best.similarity


class Gathering:
    """Pairs answers with truth and attributions by stamp, in the order of the answers.

    Args:
        loaded: the map.
        tolerance_s: how far apart the stamps of an answer and of its ground truth may be.
        most: frames kept at most.

    """

    def __init__(self, loaded: LoadedMap, tolerance_s: float = TOLERANCE_S, most: int = FRAMES) -> None:
        self.data = ReplayData(Buildings(loaded), Thinned(most))
        self._map = loaded
        self._start_ns: int | None = None
        self._score = TraversalScore(loaded.buildings, same_storey=loaded.same_storey, chance=loaded.chance)
        self._latency = LatencyHistogram()
        self._matcher: TruthMatcher[tuple[Frame, wire.PlaceMatches]] = TruthMatcher(round(tolerance_s * 1e9), _WAITING)
        self._said: dict[tuple[int, bool], wire.ClassAttributions] = {}
        self._frames: dict[int, Frame] = {}

    def answer(self, received_ns: int, answer: wire.PlaceMatches, located: Located | None = None) -> None:
        """Take an answer in; ``located`` is how the core came to it, where that is at hand.

        Raises:
            MapError: it comes from another map.

        """
        if answer.map is not None and answer.map.hash != self._map.hash:
            raise MapError(
                f"expected answers from the map {self._map.name!r} {self._map.hash[:12]} "
                f"(got answers from {answer.map.name!r} {answer.map.hash[:12]})"
            )
        data = self.data
        self._start_ns = received_ns if self._start_ns is None else self._start_ns
        data.answers += 1
        data.statuses[answer.status] += 1
        data.calibrated |= answer.calibrated
        if answer.latency_ms is not None:
            self._latency.add(answer.latency_ms)
        seconds = round((received_ns - self._start_ns) / 1e9, 3)
        frame = Frame(seconds, answer.stamp_ns, answer.seq, answer.status, candidates_of(answer, data.buildings))
        self._frames[answer.stamp_ns] = frame
        _keep_latest(self._frames)
        for layout in (True, False):
            self._join(answer.stamp_ns, layout)
        if located is not None and frame.candidates:
            data.run = True
            weigh(frame, located, data.buildings)
        self._take_all(self._matcher.item(answer.stamp_ns, (frame, answer)))

    def truth(self, truth: Truth) -> None:
        """Take a true pose in."""
        self._take_all(self._matcher.truth(truth))

    def said(self, message: wire.ClassAttributions) -> None:
        """Take in what was said of an answer, before it or after."""
        layout = message.method == LAYOUT
        self._said[message.stamp_ns, layout] = message
        _keep_latest(self._said)
        self._join(message.stamp_ns, layout)

    def finish(self) -> ReplayData:
        """All that was gathered; there will be no more."""
        self._take_all(self._matcher.rest())
        data = self.data
        data.rows = cast("list[Row]", self._score.rows(self._map.model.encoder.name))
        data.unscored = self._score.unscored
        data.p50_ms, data.p99_ms = self._latency.percentile(50), self._latency.percentile(99)
        return data

    def _take_all(self, due: Iterator[tuple[tuple[Frame, wire.PlaceMatches], Truth | None]]) -> None:
        for (frame, answer), truth in due:
            if truth is not None:
                self._judge(frame, answer, truth)
            self.data.frames.add(frame)

    def _judge(self, frame: Frame, answer: wire.PlaceMatches, truth: Truth) -> None:
        orientation = getattr(truth, "orientation_xyzw", None)
        yaw = None if orientation is None else yaw_of(orientation)
        if not self._score.add(answer, truth.position, truth.frame_id, yaw):
            return
        building = self._score.building_of(truth.frame_id)
        assert building is not None
        x, y, z = (round(value, 2) for value in truth.position)
        storey = self.data.buildings.storey(building, truth.position)
        frame.truth = TruePose(building, (x, y, z), storey, None if yaw is None else round(yaw, 3))
        frame.right = any(self._score.right(answer, building, truth.position)[:1])
        best = answer.matches[0] if answer.matches else None
        if best is not None and best.map == building:
            at = best.position if best.pose is None else best.pose.position
            frame.off_m = round(float(np.linalg.norm(np.subtract(at, truth.position))), 3)
            if best.pose is not None and best.pose.yaw is not None and yaw is not None:
                turn = np.angle(np.exp(1j * (best.pose.yaw - yaw)), deg=True)
                frame.off_deg = round(abs(float(turn)), 2)

    def _join(self, stamp_ns: int, layout: bool) -> None:
        """Put an answer and what was said of it together, whichever came first."""
        if stamp_ns not in self._frames or (stamp_ns, layout) not in self._said:
            return
        frame, message = self._frames[stamp_ns], self._said.pop((stamp_ns, layout))
        if layout:
            see(frame, message, self.data.buildings)
        else:
            look(frame, message)


def _keep_latest(waiting: dict[T, object] | dict[T, Frame] | dict[T, wire.ClassAttributions]) -> None:
    if len(waiting) > _WAITING:
        del waiting[next(iter(waiting))]
