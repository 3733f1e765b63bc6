"""What a detector sees at once, and what a builder of graphs knows of a thing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from semloc_core.errors import MessageError
from semloc_core.graph import Floats
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import FARTHEST
from semloc_core.text import short_repr
from semloc_core.wire import NAMELESS, Position

MOST = 1000
"""Detections in a view at most: what a view costs grows with their square."""
SLACK = 1e-6
"""Scores that were float32 may be so much above 1."""
SAME_M = 0.1
OVERLAP = 0.5
"""Boxes that have so much of both in common are of one thing."""


@short_repr
class Detection(NamedTuple):
    """A thing in view.

    Attributes:
        scores: class -> score in 0 … 1; empty: it has no name.
        pose: of its box, in the sensor's frame.
        size: edge lengths of the box along its own axes, m; None where not known.
        track: id that a tracker gave it; empty: none.

    """

    scores: Mapping[str, float]
    pose: Rigid
    size: Position | None = None
    track: str = ""


@short_repr
class View(NamedTuple):
    """What a sensor saw at once.

    Attributes:
        stamp_ns: when.
        robot: pose of the robot in the graph's frame.
        sensor: pose of the sensor in the graph's frame.
        detections: in the sensor's frame; none is a view as well.
        source: the sensor's name: tracking ids are its own.
        optical: the sensor looks along z, with y down, as cameras' optical frames do; else along x, with z up.

    """

    stamp_ns: int
    robot: Rigid
    sensor: Rigid
    detections: tuple[Detection, ...]
    source: str = ""
    optical: bool = False


@short_repr
@dataclass(eq=False)
class Thing:
    """An object, published or not."""

    key: str
    position: Floats
    size: Floats | None
    weight: float
    labels: dict[str, float]
    total: float = 0.0
    sightings: int = 0
    missed: int = 0
    seen_from: set[str] = field(default_factory=set)
    parent: str = ""

    def take(self, one: Seen, memory: float) -> None:
        """Fuse a detection that is of it; no more than so many sightings are remembered."""
        weight = 1.0 / max(one.away, 1.0) ** 2  # stereo's and depth cameras' errors grow with the square
        part = weight / (self.weight + weight)
        self.position = self.position + part * (one.position - self.position)
        self.weight = min(self.weight + weight, memory)
        if one.size is not None:
            self.size = one.size if self.size is None else self.size + part * (one.size - self.size)
        fade = min(1.0, memory / (self.total + 1.0))
        names = [*self.labels, *(name for name in one.scores if name not in self.labels)]
        self.labels = {name: fade * (self.labels.get(name, 0.0) + one.scores.get(name, 0.0)) for name in names}
        self.total = fade * (self.total + 1.0)
        self.sightings += 1
        self.missed = 0

    def shares(self) -> dict[str, float]:
        """Class -> share of all sightings, 6 decimals; what has no name is the rest."""
        found = {name: round(score / self.total, 6) for name, score in self.labels.items()} if self.total else {}
        return {name: share for name, share in sorted(found.items()) if share > 0}

    def class_(self) -> str:
        """The likeliest class; of equal ones the first by name."""
        shares = self.shares()
        return min(shares, key=lambda name: (-shares[name], name)) if shares else NAMELESS


@short_repr
class Seen(NamedTuple):
    """A detection in the graph's frame, checked."""

    position: Floats
    size: Floats | None
    scores: dict[str, float]
    track: str
    away: float
    score: float


def checked(view: View, min_score: float) -> list[Seen]:
    """What a view has, in the graph's frame: what scores lower is left out, and what is there twice.

    Raises:
        MessageError: a pose, size or score is none, or there are more than `MOST` detections.

    """
    if len(view.detections) > MOST:
        raise MessageError(f"expected at most {MOST} detections at once (got {len(view.detections)})")
    for pose in (view.robot, view.sensor, *(detection.pose for detection in view.detections)):
        check_pose(pose)
    found = [_seen(view, detection, min_score) for detection in view.detections]
    return once([one for one in found if one is not None])


def check_pose(pose: Rigid) -> None:
    """Refuse with a `MessageError` what is no pose."""
    where, turn = pose.translation, pose.quaternion
    if not ((np.abs(where) <= FARTHEST).all() and np.isfinite(turn).all()):
        raise MessageError(f"expected a position of at most 10⁹ m and a turn (got {where.tolist()}, {turn.tolist()})")


def _seen(view: View, detection: Detection, min_score: float) -> Seen | None:
    scores = dict(detection.scores)
    for name, score in scores.items():
        if not (name and 0.0 <= score <= 1.0 + SLACK):
            raise MessageError(f"expected class names with scores in 0 … 1 (got {name!r}: {score})")
    size = detection.size
    if size is not None and not all(0.0 <= edge <= FARTHEST for edge in size):
        raise MessageError(f"expected a size of 0 m and more (got {size})")
    pose = view.sensor @ detection.pose
    if not (np.abs(pose.translation) <= FARTHEST).all():
        raise MessageError(f"expected a position of at most 10⁹ m (got {pose.translation.tolist()})")
    best = max(scores.values(), default=1.0)
    if best < min_score:
        return None
    scores.pop(NAMELESS, None)  # a position without a name, which is what the rest of the scores stands for
    total = max(sum(scores.values()), 1.0)
    scores = {name: score / total for name, score in scores.items()}
    box = np.abs(pose.rotation) @ np.array(size) if size is not None and any(size) else None
    away = float(np.linalg.norm(pose.translation - view.sensor.translation))
    return Seen(pose.translation, box, scores, detection.track, away, best)


def once(seen: list[Seen]) -> list[Seen]:
    """Without what a detector says twice of one thing: of boxes that overlap by half only the best scored stays.

    Detectors do so that suppress overlaps class by class, or not at all. What has no box is there twice within
    `SAME_M`. Things with tracking ids of their own are two.
    """
    n = len(seen)
    if n < 2:
        return seen
    at = np.array([one.position for one in seen])
    half = np.array([np.full(3, SAME_M / 2) if one.size is None else one.size / 2 for one in seen])
    order = np.lexsort((np.arange(n), -np.array([one.score for one in seen])))
    stays: list[int] = []
    for i in order.tolist():
        if stays:
            low = np.maximum(at[i] - half[i], at[stays] - half[stays])
            high = np.minimum(at[i] + half[i], at[stays] + half[stays])
            common = np.maximum(high - low, 0.0).prod(axis=1)
            both = (2 * half[i]).prod() + (2 * half[stays]).prod(axis=1) - common
            alike = common >= OVERLAP * np.maximum(both, 1e-12)
            if any(not (seen[i].track and seen[stays[k]].track) for k in np.flatnonzero(alike).tolist()):
                continue
        stays.append(i)
    return [seen[i] for i in sorted(stays)]
