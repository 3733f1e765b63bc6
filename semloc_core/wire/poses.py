"""Published poses as others read them: geometry_msgs' fields, and TUM trajectories (evo reads them)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from semloc_core.files import write_whole
from semloc_core.wire.messages import Odometry, PlaceMatches, Pose, Position, Transform

Quaternion = tuple[float, float, float, float]
_OF_ROS = (0, 1, 2, 5)
"""Where x, y, z and yaw are in ROS's x, y, z, roll, pitch, yaw."""


def yaw_of(orientation_xyzw: Quaternion) -> float:
    """The heading of a unit quaternion, radians."""
    x, y, z, w = orientation_xyzw
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion_of(yaw: float | None) -> Quaternion:
    """The unit quaternion (x, y, z, w) of a heading, radians; no turn where it is not known."""
    half = 0.5 * (yaw or 0.0)
    return 0.0, 0.0, math.sin(half), math.cos(half)


def orientation_of(pose: Pose, odometry: Odometry | None) -> Quaternion:
    """The unit quaternion (x, y, z, w) of a pose: its heading, leaning as the odometry that it comes from says."""
    if pose.yaw is None or odometry is None:
        return quaternion_of(pose.yaw)
    x, y, z, w = odometry.orientation_xyzw
    _, _, sine, cosine = quaternion_of(pose.yaw - yaw_of(odometry.orientation_xyzw))
    return cosine * x - sine * y, cosine * y + sine * x, cosine * z + sine * w, cosine * w - sine * z


def moved(transform: Transform, position: Position) -> Position:
    """A position in the frame of the updates, in the building's (m)."""
    sine, cosine = math.sin(transform.yaw), math.cos(transform.yaw)
    (x, y, z), (along, across, up) = position, transform.translation
    return cosine * x - sine * y + along, sine * x + cosine * y + across, z + up


def ros_covariance(pose: Pose) -> list[float]:
    """The 6×6 covariance of a geometry_msgs/PoseWithCovariance, row-major; gravity is known: no roll, no pitch."""
    found = [0.0] * 36
    for i, row in enumerate(_OF_ROS):
        for j, column in enumerate(_OF_ROS):
            found[6 * row + column] = pose.covariance[4 * i + j]
    return found


def matched_pose(matches: PlaceMatches) -> Pose | None:
    """The pose of an answer that is a match; else None."""
    return matches.matches[0].pose if matches.status == "match" else None


class TumWriter:
    """Writes trajectories, a file a building, and the true ones beside them, when its ``with`` block ends.

    A line is ``seconds x y z qx qy qz qw``; where a heading is not known the orientation is none. Only answers with
    status ``match`` are written. Of a map of one building the file is ``path``; of more, ``path`` with the building's
    name before its suffix. The truth is in a file whose name has ``truth`` there.

    Args:
        path: of the file.
        buildings: of the map.

    """

    def __init__(self, path: Path, buildings: Sequence[str]) -> None:
        self._path, self._several = path, len(buildings) != 1
        self._lines: dict[tuple[str, bool], list[str]] = {}

    @property
    def files(self) -> list[Path]:
        """What was written, by name."""
        return sorted(self._named(*key) for key in self._lines)

    def answer(self, matches: PlaceMatches) -> None:
        """Take an answer, if it is a match."""
        pose = matched_pose(matches)
        if pose is not None:
            self._line(matches.matches[0].map, False, matches.stamp_ns, pose.position, quaternion_of(pose.yaw))

    def truth(self, building: str, stamp_ns: int, position: Position, orientation_xyzw: Quaternion | None) -> None:
        """Take where the robot truly was."""
        self._line(building, True, stamp_ns, position, orientation_xyzw or quaternion_of(None))

    def _named(self, building: str, truth: bool) -> Path:
        parts = [building.replace("/", "_")] if self._several else []
        parts += ["truth"] if truth else []
        return self._path.with_name(".".join([self._path.stem, *parts]) + self._path.suffix)

    def _line(self, building: str, truth: bool, stamp_ns: int, position: Position, turn: Quaternion) -> None:
        key = (building, truth)
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        numbers = " ".join(f"{value + 0.0:.6f}" for value in (*position, *turn))
        self._lines.setdefault(key, []).append(f"{seconds}.{nanoseconds:09d} {numbers}\n")

    def __enter__(self) -> TumWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:  # else there is no whole trajectory to write
            for key, lines in self._lines.items():
                write_whole(self._named(*key), "".join(lines).encode())
