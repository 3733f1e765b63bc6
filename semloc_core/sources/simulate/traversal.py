"""A simulated run: a robot walks through a known building and its scene graph is revealed as a sensor would.

It walks the traversability graph by way of random goals, or along recorded poses. Places within the sensing range,
measured along the graph from where it stands (so not through walls), and the objects attached to them enter
the run's graph; a ``full`` update comes first and every few seconds, deltas between.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.config import Some
from semloc_core.graph import SceneGraph, ball
from semloc_core.sources.simulate.drift import Frame
from semloc_core.sources.simulate.route import WalkPoint, walk_along, walk_to_goals
from semloc_core.sources.simulate.sensor import Delta, DetectorErrors, Revealed, perceive
from semloc_core.text import short_repr
from semloc_core.wire import Odometry, Position, SceneGraphUpdate

_NS_PER_S = 1_000_000_000
Seconds = Annotated[float, Meta(ge=0.0, le=1e8)]
PerMetre = Annotated[float, Meta(ge=0.0, le=10.0)]


class SimulationConfig(DetectorErrors, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of a simulated run; make one with `of`, which checks ranges."""

    speed_mps: Annotated[float, Meta(gt=0.0, le=100.0, description="walking speed, m/s")] = 0.5
    rate_hz: Annotated[Some, Meta(description="updates per second, Hz")] = 2.0
    distance_m: Annotated[
        float,
        Meta(
            ge=0.0,
            le=1e7,
            description="how far to walk between random goals, m; 0 for no limit; poses are followed to their end",
        ),
    ] = 60.0
    duration_s: Annotated[Seconds, Meta(description="how long the run lasts at most, s; 0 for no limit")] = 0.0
    start_place: Annotated[
        str, Meta(description="id of the place to start from; empty: a random one of the largest connected part")
    ] = ""
    range_m: Annotated[Some, Meta(description="sensing range along traversability edges, m")] = 5.0
    full_every_s: Annotated[Seconds, Meta(description="seconds between full updates; 0: each update is full")] = 10.0
    fresh_ids: Annotated[
        bool, Meta(description="give nodes ids of the run's own, which say nothing about the map's")
    ] = True
    odometry: Annotated[bool, Meta(description="whether updates carry odometry")] = True
    odometry_noise: Annotated[
        PerMetre, Meta(description="standard deviation of odometry, m per axis after one metre walked")
    ] = 0.0
    odometry_yaw_noise: Annotated[
        PerMetre, Meta(description="standard deviation of odometry's yaw, rad after one metre walked")
    ] = 0.0
    shared_frame: Annotated[
        bool, Meta(description="whether odometry, then free of noise, is in the updates' frame and says so")
    ] = False
    frame_id: Annotated[str, Meta(description="frame of the updates")] = "map"
    start_stamp_ns: Annotated[int, Meta(ge=0, le=2**61, description="stamp of the first update, ns")] = (
        1_700_000_000 * _NS_PER_S
    )


@short_repr
class Step(NamedTuple):
    """One update of a simulated run.

    Attributes:
        update: what the robot publishes.
        position: where it truly is, metres, in the building's frame.
        place: the building's place that is nearest (the update's ``query_place``, under the building's id).
        heading: its true heading there, radians.

    """

    update: SceneGraphUpdate
    position: Position
    place: str
    heading: float = 0.0


class RecordedPose(Protocol):
    """A pose of a recorded run, e.g. of a Hydra file's agent: stamp (ns) and position (m)."""

    @property
    def stamp_ns(self) -> int:
        """When, ns."""

    @property
    def position(self) -> Position:
        """Where, metres."""


def simulate_traversal(
    graph: SceneGraph,
    config: SimulationConfig,
    rng: np.random.Generator,
    agents: Sequence[RecordedPose] | None = None,
) -> Iterator[Step]:
    """Walk through a building and say what is seen.

    A building of a single place, or poses that stand still, give a single step. Walk, detector and odometry draw
    from generators of their own, so that another miss rate does not change the way that is walked.

    Args:
        graph: the building.
        config: options.
        rng: source of all that is random.
        agents: poses to follow instead of random goals, in order of their stamps and at the configured speed; the
            graph is then seen from the place nearest to each.

    Raises:
        GraphError: the graph has no places.
        ConfigError: an option is out of its range, or the start place is not in the graph.

    """
    config = SimulationConfig.of(**msgspec.structs.asdict(config))
    walk_rng, detector_rng, flicker_rng, odometry_rng = rng.spawn(4)
    drift_rng = rng.spawn(1)[0] if config.drift else None
    step_m = config.speed_mps / config.rate_hz
    if agents:
        poses = [pose.position for pose in sorted(agents, key=lambda pose: pose.stamp_ns)]
        points = walk_along(graph, poses, step_m)
    else:
        points = walk_to_goals(graph, config.start_place, step_m, config.distance_m, walk_rng)
    revealed = Revealed(graph, perceive(graph, config, detector_rng), fresh_ids=config.fresh_ids)
    odometer = _Odometer(config, odometry_rng)
    full_at, frame, last = 0.0, Frame(), 0.0
    for seq, point in enumerate(points):
        seconds = seq / config.rate_hz
        if config.duration_s and seconds > config.duration_s:
            return
        if drift_rng is not None:
            frame = frame.drifted(np.array(point.position), point.travelled - last, drift_rng, config.drift)
            last = point.travelled
        in_range = _in_range(graph, point, config.range_m)
        delta = revealed.see(in_range, config.flicker_rate, flicker_rng, frame if config.drift else None)
        if full := seconds >= full_at:
            delta, full_at = revealed.everything(), seconds + config.full_every_s
        stamp_ns = config.start_stamp_ns + round(seq * _NS_PER_S / config.rate_hz)
        update = _update(revealed, delta, point, config.frame_id, seq, stamp_ns, full, odometer.at(point, frame))
        yield Step(update, point.position, point.place, point.heading)


def _in_range(graph: SceneGraph, point: WalkPoint, range_m: float) -> set[str]:
    """The places at most ``range_m`` away along the graph, and always the nearest one."""
    found = {point.place}
    for place, metres in point.near.items():
        if metres <= range_m:
            found.update(ball(graph.neighbours, place, range_m - metres))
    return found


def _update(
    revealed: Revealed,
    delta: Delta,
    point: WalkPoint,
    frame_id: str,
    seq: int,
    stamp_ns: int,
    full: bool,
    odometry: Odometry | None,
) -> SceneGraphUpdate:
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        seq=seq,
        full=full,
        places=[revealed.place(key) for key in delta.places],
        objects=[revealed.object(key) for key in delta.objects],
        edges=[(revealed.name(a), revealed.name(b)) for a, b in delta.edges],
        query_place=revealed.name(point.place),
        removed_nodes=[revealed.name(key) for key in delta.removed],
        odometry=odometry,
    )


class _Odometer:
    """Dead reckoning in a frame that starts at the robot's first pose, so that it tells nothing about the map's.

    Where the frame is shared, the robot's pose in the updates' frame instead, as that has drifted by then.
    """

    def __init__(self, config: SimulationConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._last: WalkPoint | None = None
        self._first_heading = 0.0
        self._yaw_error = 0.0
        self._position = np.zeros(3)

    def at(self, point: WalkPoint, frame: Frame) -> Odometry | None:
        if not self._config.odometry:
            return None
        if self._config.shared_frame:
            here, half = frame.of(np.array(point.position)).tolist(), (point.heading + frame.yaw) / 2
            facing = (0.0, 0.0, math.sin(half), math.cos(half))
            return Odometry((here[0], here[1], here[2]), facing, self._config.frame_id)
        if self._last is None:
            self._last, self._first_heading = point, point.heading
        x, y, z = (q - p for p, q in zip(self._last.position, point.position, strict=True))
        # The errors of independent steps add up as variances: per root metre.
        spread = math.sqrt(point.travelled - self._last.travelled)
        shift, turn = self._rng.normal(0.0, 1.0, 3), float(self._rng.normal())
        self._yaw_error += turn * spread * self._config.odometry_yaw_noise
        angle = self._yaw_error - self._first_heading
        cosine, sine = math.cos(angle), math.sin(angle)
        self._position += (cosine * x - sine * y, sine * x + cosine * y, z)
        self._position += shift * spread * self._config.odometry_noise
        self._last = point
        half = (point.heading + angle) / 2
        px, py, pz = (float(value) for value in self._position)
        return Odometry((px, py, pz), (0.0, 0.0, math.sin(half), math.cos(half)))
