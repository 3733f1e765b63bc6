"""A simulated run of a robot with cameras and a 3D detector: what it detects on its way."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from semloc_core.config import Checked, Share, Some, Spread
from semloc_core.graph import Floats, SceneGraph, ball
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import Grid
from semloc_core.sources.detections.growth.things import Detection
from semloc_core.sources.detections.nav2 import short
from semloc_core.sources.detections.stream import OPTICAL
from semloc_core.sources.simulate.drift import Frame
from semloc_core.sources.simulate.route import WalkPoint, walk_along, walk_to_goals
from semloc_core.sources.simulate.traversal import RecordedPose
from semloc_core.text import short_repr
from semloc_core.wire import Object, Position, quaternion_of

_NS_PER_S = 1_000_000_000
DETOUR, DETOUR_M = 1.25, 1.0
"""Without walls: what is seen is not much farther by the way than straight, so many times and metres more at most."""


class DetectorConfig(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The robot, its cameras and its detector; make one with `of`, which checks ranges."""

    speed_mps: Annotated[float, Meta(gt=0.0, le=100.0, description="walking speed, m/s")] = 0.5
    rate_hz: Annotated[Some, Meta(description="frames of each camera per second")] = 4.0
    distance_m: Annotated[float, Meta(ge=0.0, le=1e7, description="how far to walk between random goals, m")] = 60.0
    cameras: Annotated[int, Meta(ge=1, le=16, description="cameras, evenly around, the first ahead")] = 1
    horizontal_fov_deg: Annotated[float, Meta(gt=0.0, le=360.0, description="of each camera, degrees")] = 90.0
    vertical_fov_deg: Annotated[float, Meta(gt=0.0, le=180.0, description="of each camera, degrees")] = 60.0
    range_m: Annotated[Some, Meta(description="how far the detector sees, m")] = 5.0
    miss_rate: Annotated[Share, Meta(description="chance, in each frame, that an object is missed")] = 0.2
    confusion_rate: Annotated[Share, Meta(description="chance, in each frame, that another class scores best")] = 0.1
    false_rate: Annotated[Spread, Meta(description="invented detections for each true one")] = 0.02
    depth_noise: Annotated[
        float, Meta(ge=0.0, le=10.0, description="standard deviation of depth at 1 m, m; it grows with the square")
    ] = 0.005
    drift: Annotated[Spread, Meta(description="drift of odometry; 1: 0.5° and 0.03 m per axis, a root metre")] = 0.0
    frame_id: Annotated[str, Meta(description="frame of the ground truth, the building's")] = "map"
    start_stamp_ns: Annotated[int, Meta(ge=0, le=2**61, description="stamp of the first frame, ns")] = (
        1_700_000_000 * _NS_PER_S
    )


@short_repr
class Glance(NamedTuple):
    """What all cameras see at once.

    Attributes:
        stamp_ns: when.
        position: where the robot truly is, m.
        heading: its true heading there, rad.
        odometry: where odometry has it.
        frames: for each camera its pose on the robot (optical frame), and what is detected, in that frame.

    """

    stamp_ns: int
    position: Position
    heading: float
    odometry: Rigid
    frames: tuple[tuple[Rigid, tuple[Detection, ...]], ...]


def simulate_detections(
    graph: SceneGraph,
    config: DetectorConfig,
    rng: np.random.Generator,
    *,
    agents: Sequence[RecordedPose] | None = None,
    grid: Grid | None = None,
    start_place: str = "",
) -> Iterator[Glance]:
    """Walk through a building and say what cameras detect.

    Way, detector and drift draw from generators of their own: another miss rate does not change the way. Walls hide
    what is behind them where a grid has them; else what is much farther by the way than straight is hidden.

    Args:
        graph: the building; its objects without an edge to a place can't be seen.
        config: options.
        rng: source of all that is random.
        agents: poses to follow instead of random goals.
        grid: walls, in the building's frame.
        start_place: to walk from; empty: a random one.

    Raises:
        GraphError: the graph has no places.

    """
    walk_rng, detector_rng, drift_rng = rng.spawn(3)
    step_m = config.speed_mps / config.rate_hz
    if agents:
        poses = [pose.position for pose in sorted(agents, key=lambda pose: pose.stamp_ns)]
        points = walk_along(graph, poses, step_m)
    else:
        points = walk_to_goals(graph, start_place, step_m, config.distance_m, walk_rng)
    detector = _Detector(graph, config, detector_rng, grid)
    mounts = [
        Rigid.of((0.0, 0.0, 0.0), quaternion_of(2 * math.pi * i / config.cameras)) @ OPTICAL
        for i in range(config.cameras)
    ]
    frame, last = Frame(), 0.0
    for number, point in enumerate(points):
        if config.drift:
            frame = frame.drifted(np.array(point.position), point.travelled - last, drift_rng, config.drift)
            last = point.travelled
        body = Rigid.of(point.position, quaternion_of(point.heading))
        x, y, z = frame.of(np.array(point.position)).tolist()
        seen = detector.in_sight(point)
        yield Glance(
            config.start_stamp_ns + round(number * _NS_PER_S / config.rate_hz),
            point.position,
            point.heading,
            Rigid.of((x, y, z), quaternion_of(point.heading + frame.yaw)),
            tuple((mount, tuple(detector.detections(body @ mount, seen))) for mount in mounts),
        )


class _Detector:
    def __init__(self, graph: SceneGraph, config: DetectorConfig, rng: np.random.Generator, grid: Grid | None) -> None:
        self._graph, self._config, self._rng, self._grid = graph, config, rng, grid
        self._frequency = Counter(thing.class_ for thing in graph.objects.values())

    def in_sight(self, point: WalkPoint) -> list[Object]:
        """Objects in range with nothing between, by id."""
        here, range_m = np.array(point.position), self._config.range_m
        metres: dict[str, float] = {}
        for place, first in point.near.items():
            for other, more in ball(self._graph.neighbours, place, DETOUR * range_m + DETOUR_M).items():
                metres[other] = min(first + more, metres.get(other, math.inf))
        found = []
        for key in sorted({key for place in metres for key in self._graph.children.get(place, ())}):
            thing = self._graph.objects[key]
            away = math.dist(thing.position, point.position)
            if away > range_m:
                continue
            if self._grid is not None:
                ends = np.array([thing.position[:2]])
                if self._grid.sight(here[None, :2], ends, short(thing.size))[0]:
                    found.append(thing)
                continue
            places = [place for place in self._graph.parents[key] if place in metres]
            way = min(metres[place] + math.dist(self._graph.places[place], thing.position) for place in places)
            if way <= DETOUR * away + DETOUR_M:
                found.append(thing)
        return found

    def detections(self, sensor: Rigid, seen: Iterable[Object]) -> Iterator[Detection]:
        """What a camera's detector makes of what is in sight: in the camera's optical frame."""
        config, rng, back = self._config, self._rng, sensor.inverse
        wide, high = math.radians(config.horizontal_fov_deg) / 2, math.radians(config.vertical_fov_deg) / 2
        for thing in seen:
            where = back.translation + back.rotation @ np.array(thing.position)
            right, down, ahead = where.tolist()
            chances, noise = rng.random(4), rng.normal(0.0, 1.0, 7)
            if abs(math.atan2(right, ahead)) > wide or abs(math.atan2(down, math.hypot(ahead, right))) > high:
                continue
            if chances[0] < config.miss_rate:
                continue
            yield self._detection(back, where, thing.class_, thing.size, chances, noise)
            if rng.random() < config.false_rate:
                angle = rng.uniform(-wide, wide)
                away = rng.uniform(0.5, config.range_m)
                invented = np.array([away * math.sin(angle), rng.uniform(-0.3, 0.5), away * math.cos(angle)])
                class_ = self._draw(thing.class_)
                yield self._detection(back, invented, class_, (0.4, 0.4, 0.4), rng.random(4), rng.normal(size=7))

    def _detection(
        self, back: Rigid, where: Floats, class_: str, size: Position | None, chances: Floats, noise: Floats
    ) -> Detection:
        away = float(np.linalg.norm(where))
        spread = self._config.depth_noise * away**2
        where = where + where / max(away, 1e-9) * spread * noise[0] + 0.2 * spread * noise[1:4]
        other = self._draw(class_)
        best, second = (other, class_) if chances[1] < self._config.confusion_rate else (class_, other)
        score = 0.55 + 0.4 * float(chances[2])
        scores = {best: round(score, 4), second: round((1 - score) * float(chances[3]), 4)}
        box = None
        if size is not None:
            a, b, c = (max(0.01, edge * (1 + 0.1 * n)) for edge, n in zip(size, noise[4:].tolist(), strict=True))
            box = (a, b, c)
        # The box stands upright in the building, as a detector that knows gravity gives it.
        return Detection(scores if best != second else {best: scores[second]}, Rigid(where, back.quaternion), box)

    def _draw(self, but: str) -> str:
        """Another class, by how frequent it is."""
        names = sorted(name for name in self._frequency if name != but) or [but]
        weights = np.array([self._frequency[name] for name in names], dtype=np.float64)
        return names[int(self._rng.choice(len(names), p=weights / weights.sum()))]
