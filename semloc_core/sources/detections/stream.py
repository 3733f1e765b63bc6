"""ROS's messages, from a bag or live, to updates: `vision_msgs/Detection3DArray`, odometry, transforms, a grid.

Messages are anything with their fields: what rosbags reads and what rclpy hands over. What stands before its
transform waits for it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from msgspec import Meta

from semloc_core.errors import GraphError, MessageError
from semloc_core.sources.detections.frames import IDENTITY, LateError, NoPathError, Rigid
from semloc_core.sources.detections.grid import Grid
from semloc_core.sources.detections.growth.builder import GraphBuilder
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.things import Detection, View
from semloc_core.wire import SceneGraphUpdate, yaw_of

_NS_PER_S = 1_000_000_000
_WAITING = 1000
"""Views that wait for their transforms at most."""
_WORLD = ("map", "odom", "world", "earth")
OPTICAL = Rigid.of((0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5))
"""Of a camera's optical frame (z ahead, y down) in one with x ahead and z up."""
BACK_NS = 2 * _NS_PER_S
"""Stamps that go back by more are a clock, or a bag, that begins again."""


class StreamConfig(BuilderConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of a `DetectionStream`; those of the graph are `BuilderConfig`'s."""

    frame_id: Annotated[
        str, Meta(description="frame of the graph, which the robot moves in; empty: odometry's, or else odom")
    ] = ""
    robot_frame: Annotated[str, Meta(description="frame of the robot; empty: odometry's child, or else base_link")] = ""
    rate_hz: Annotated[float, Meta(gt=0.0, le=1000.0, description="updates per second at most, by stamps, Hz")] = 2.0
    wait_s: Annotated[
        float, Meta(ge=0.0, le=60.0, description="how long detections wait for a late transform, by stamps, s")
    ] = 1.0


class Transforms(Protocol):
    """What knows the transforms: `Frames`, or tf2's buffer."""

    def lookup(self, target: str, source: str, stamp_ns: int) -> Rigid:
        """The transform from a frame into another; `LateError` while it may still come, `MessageError` if never."""


class _Waiting(NamedTuple):
    stamp_ns: int
    frame: str
    detections: list[tuple[str, Detection]]


class DetectionStream:
    """Messages in, updates out.

    Args:
        config: options.
        transforms: knows them, odometry's among them where nothing else does.

    Attributes:
        passed_over: what could not be used, by reason.

    """

    def __init__(self, config: StreamConfig, transforms: Transforms) -> None:
        self._config, self._transforms = config, transforms
        self._frame_id, self._robot = config.frame_id, config.robot_frame
        self._builder: GraphBuilder | None = None
        self._waiting: deque[_Waiting] = deque()
        self._grid: tuple[str, Grid] | None = None
        self._now_ns = self._last_ns = 0
        self._due_ns: int | None = None
        self._assumed: set[str] = set()
        self.passed_over: Counter[str] = Counter()

    def ask_full(self) -> None:
        """Have the next update be a full one."""
        if self._builder is not None:
            self._builder.ask_full()

    def detections(self, message: Any) -> Iterator[SceneGraphUpdate]:
        """A Detection3DArray; what it makes ready comes out.

        Raises:
            MessageError: a number in it is none; nothing of it is used.

        """
        stamp_ns, frame = _header(message.header)
        found = [(_header(one.header)[1] or frame, _detection(one)) for one in message.detections]
        if stamp_ns < self._now_ns - BACK_NS:
            self._restart()
        self._waiting.append(_Waiting(stamp_ns, frame, found))
        if len(self._waiting) > _WAITING:
            self._drop("more detections than can wait for their transforms")
        self._now_ns = max(self._now_ns, stamp_ns)
        yield from self.poll()

    def odometry(self, message: Any) -> tuple[str, str, int, Rigid]:
        """An Odometry as a transform: parent, child, stamp (ns), pose. It names the frames that no option does.

        Raises:
            MessageError: a number in it is none.

        """
        stamp_ns, frame = _header(message.header)
        pose, child = _pose(message.pose.pose), message.child_frame_id or "base_link"
        self._frame_id = self._frame_id or frame
        self._robot = self._robot or child
        return frame, child, stamp_ns, pose

    def grid(self, message: Any) -> None:
        """An OccupancyGrid; it takes effect with the next view whose transforms are known.

        Raises:
            MessageError: a size that its data has not.

        """
        _, frame = _header(message.header)
        info = message.info
        cells = np.asarray(message.data, dtype=np.int8)
        if len(cells) != info.width * info.height:
            raise MessageError(f"expected {info.width} × {info.height} cells (got {len(cells)})")
        pose = _pose(info.origin)
        x, y, _ = pose.translation.tolist()
        try:
            grid = Grid(cells.reshape(info.height, info.width), float(info.resolution), (x, y, _yaw(pose)))
        except GraphError as error:
            raise MessageError(str(error)) from error
        self._grid = frame, grid

    def poll(self, *, end: bool = False) -> Iterator[SceneGraphUpdate]:
        """Take what is no longer waiting for a transform.

        Args:
            end: nothing more comes, so what waits is passed over, and what is left to be said is said.

        """
        while self._waiting:
            first = self._waiting[0]
            try:
                view = self._views(first)
            except LateError as error:
                if not end and self._now_ns - first.stamp_ns <= self._config.wait_s * 1e9:
                    return
                if isinstance(error, NoPathError) and error.frame not in self._assumed | {self._robot_frame}:
                    self._assumed.add(error.frame)
                    self.passed_over[f"frame {error.frame} without a transform: taken to be where the robot is"] += 1
                else:
                    self._drop(str(error))
                continue
            except MessageError as error:
                self._drop(str(error))
                continue
            self._waiting.popleft()
            yield from self._take(first.stamp_ns, view)
        if end and self._builder is not None and self._due_ns is not None and self._last_ns > self._due_ns:
            yield self._builder.update()

    def _take(self, stamp_ns: int, views: list[View]) -> Iterator[SceneGraphUpdate]:
        if self._builder is None:
            self._builder = GraphBuilder(self._config, self._graph_frame)
        try:
            self._builder.see(*views)
        except MessageError as error:
            self.passed_over[str(error)] += 1
            return
        self._place_grid(stamp_ns)
        self._last_ns = max(self._last_ns, stamp_ns)
        if self._due_ns is None or stamp_ns >= self._due_ns + round(1e9 / self._config.rate_hz):
            self._due_ns = stamp_ns
            yield self._builder.update()

    def _views(self, waiting: _Waiting) -> list[View]:
        """A view for each frame that detections are in, the array's own always; in the frame of the graph."""
        robot = self._transforms.lookup(self._graph_frame, self._robot_frame, waiting.stamp_ns)
        frames = [waiting.frame, *(frame for frame, _ in waiting.detections if frame != waiting.frame)]
        views = []
        for frame in dict.fromkeys(frames):
            mine = [one for of, one in waiting.detections if of == frame]
            optical = "optical" in frame
            try:
                sensor = self._transforms.lookup(self._graph_frame, frame, waiting.stamp_ns)
            except NoPathError:
                if frame not in self._assumed:
                    raise
                sensor = robot @ (OPTICAL if optical else IDENTITY)
            if frame in (self._graph_frame, *_WORLD):
                # Moved into a frame of the world already: seen from the robot, as far as is known.
                back = robot.inverse @ sensor
                mine = [one._replace(pose=back @ one.pose) for one in mine]
                sensor, optical = robot, False
            views.append(View(waiting.stamp_ns, robot, sensor, tuple(mine), frame, optical))
        return views

    def _place_grid(self, stamp_ns: int) -> None:
        """Hand the latest grid over, moved into the frame of the graph, once that is known."""
        if self._grid is None or self._builder is None:
            return
        frame, grid = self._grid
        if frame != self._graph_frame:
            try:
                moved = self._transforms.lookup(self._graph_frame, frame, stamp_ns)
            except MessageError:
                return  # with a later view
            x, y, yaw = grid.origin
            corner = moved @ Rigid.of((x, y, 0.0), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))
            grid = Grid(grid.cells, grid.resolution, (*corner.translation[:2].tolist(), _yaw(corner)))
        self._grid = None
        try:
            self._builder.set_grid(grid)
        except GraphError as error:
            self.passed_over[str(error)] += 1

    @property
    def _graph_frame(self) -> str:
        return self._frame_id or "odom"

    @property
    def _robot_frame(self) -> str:
        return self._robot or "base_link"

    def _drop(self, reason: str) -> None:
        self._waiting.popleft()
        self.passed_over[reason] += 1

    def _restart(self) -> None:
        self._waiting.clear()
        self._builder, self._due_ns, self._now_ns, self._last_ns = None, None, 0, 0


def _header(header: Any) -> tuple[int, str]:
    return header.stamp.sec * _NS_PER_S + header.stamp.nanosec, str(header.frame_id).lstrip("/")


def _pose(pose: Any) -> Rigid:
    """A geometry_msgs/Pose; without a turn where it has none, as many detectors leave it."""
    where, turn = pose.position, pose.orientation
    quaternion = (float(turn.x), float(turn.y), float(turn.z), float(turn.w))
    return Rigid.of((float(where.x), float(where.y), float(where.z)), quaternion if any(quaternion) else (0, 0, 0, 1))


def transform_of(message: Any) -> tuple[str, str, int, Rigid]:
    """A geometry_msgs/TransformStamped: parent, child, stamp (ns), pose of the child in the parent.

    Raises:
        MessageError: a number in it is none.

    """
    stamp_ns, parent = _header(message.header)
    where, turn = message.transform.translation, message.transform.rotation
    pose = Rigid.of((float(where.x), float(where.y), float(where.z)), (turn.x, turn.y, turn.z, turn.w))
    return parent, str(message.child_frame_id).lstrip("/"), stamp_ns, pose


def _detection(message: Any) -> Detection:
    """A Detection3D, of vision_msgs 4 or older: class and score once stood in the hypothesis with its pose itself."""
    scores: dict[str, float] = {}
    best: Any = None
    for result in message.results:
        hypothesis = getattr(result, "hypothesis", result)
        name = str(hypothesis.class_id if hasattr(hypothesis, "class_id") else hypothesis.id)
        if best is None or hypothesis.score > scores[best[0]]:
            best = name, result
        scores[name] = max(float(hypothesis.score), scores.get(name, 0.0))
    box = message.bbox
    size = (float(box.size.x), float(box.size.y), float(box.size.z))
    where = box.center.position
    pose = box.center
    if not any(size) and not any((where.x, where.y, where.z)) and best is not None and hasattr(best[1], "pose"):
        pose = best[1].pose.pose  # no box: where the likeliest hypothesis has it
    track = str(getattr(message, "id", "") or getattr(message, "tracking_id", ""))
    return Detection(scores, _pose(pose), size if any(size) else None, track)


def _yaw(pose: Rigid) -> float:
    x, y, z, w = pose.quaternion.tolist()
    return yaw_of((x, y, z, w))
