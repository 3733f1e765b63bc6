"""Rigid transforms, and a tree of frames as tf2 keeps it, for bags: the same lookups without ROS."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

import numpy as np

from semloc_core.errors import MessageError
from semloc_core.graph import Floats
from semloc_core.text import short_repr

Quaternion = tuple[float, float, float, float]
_NORM_TOLERANCE = 1e-2
_KEPT_NS = 30 * 1_000_000_000


class LateError(MessageError):
    """A transform is not known yet: later messages may bring it."""


class NoPathError(LateError):
    """Nothing joins two frames yet; ``frame`` is the one that was asked about."""

    def __init__(self, target: str, frame: str) -> None:
        super().__init__(f"expected transforms between {target} and {frame} (got none that join them)")
        self.frame = frame


@short_repr
@dataclass(frozen=True, eq=False)
class Rigid:
    """A pose, or the transform from a frame into another: (3,) translation in m, unit quaternion (x, y, z, w)."""

    translation: Floats
    quaternion: Floats

    @classmethod
    def of(cls, translation: tuple[float, float, float], quaternion: Quaternion) -> Rigid:
        """Make one of numbers as they come.

        Raises:
            MessageError: a number that is not finite, or no rotation.

        """
        where, turn = np.array(translation, dtype=np.float64), np.array(quaternion, dtype=np.float64)
        norm = float(np.linalg.norm(turn))
        if not (np.abs(where) <= 1e9).all() or not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise MessageError(f"expected a finite position and a unit quaternion (got {translation}, {quaternion})")
        return cls(where, turn / norm)

    @property
    def rotation(self) -> Floats:
        """(3, 3) matrix."""
        x, y, z, w = self.quaternion
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def __matmul__(self, other: Rigid) -> Rigid:
        (x, y, z, w), (a, b, c, d) = self.quaternion, other.quaternion
        turn = np.array(
            [
                w * a + x * d + y * c - z * b,
                w * b - x * c + y * d + z * a,
                w * c + x * b - y * a + z * d,
                w * d - x * a - y * b - z * c,
            ]
        )
        return Rigid(self.translation + self.rotation @ other.translation, turn / np.linalg.norm(turn))

    @property
    def inverse(self) -> Rigid:
        """The transform back."""
        turn = self.quaternion * (-1.0, -1.0, -1.0, 1.0)
        back = Rigid(np.zeros(3), turn)
        return Rigid(-(back.rotation @ self.translation), turn)


IDENTITY = Rigid(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


class _Link:
    """The transforms of a frame into its parent, by time; one without a time if it is static."""

    def __init__(self, parent: str, static: bool, odometry: bool) -> None:
        self.parent, self.static, self.odometry = parent, static, odometry
        self.times: deque[int] = deque()
        self.poses: deque[Rigid] = deque()

    def add(self, stamp_ns: int, pose: Rigid) -> None:
        if self.static or (self.times and stamp_ns < self.times[-1] - _KEPT_NS):  # a clock that began again
            self.times.clear()
            self.poses.clear()
        at = len(self.times) if not self.times or stamp_ns > self.times[-1] else bisect_left(self.times, stamp_ns)
        if at < len(self.times) and self.times[at] == stamp_ns:
            self.poses[at] = pose
            return
        self.times.insert(at, stamp_ns)
        self.poses.insert(at, pose)
        while self.times[0] < self.times[-1] - _KEPT_NS:
            self.times.popleft()
            self.poses.popleft()

    def at(self, stamp_ns: int, child: str) -> Rigid:
        if self.static:
            return self.poses[0]
        if stamp_ns > self.times[-1]:
            raise LateError(f"expected a newer transform of {child} (got only older ones)")
        after = bisect_left(self.times, stamp_ns)
        if self.times[after] == stamp_ns:
            return self.poses[after]
        if after == 0:
            raise MessageError(f"expected an older transform of {child} (got only newer ones)")
        a, b = self.poses[after - 1], self.poses[after]
        part = (stamp_ns - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        return Rigid(a.translation + part * (b.translation - a.translation), _slerp(a.quaternion, b.quaternion, part))


def _slerp(a: Floats, b: Floats, part: float) -> Floats:
    dot = float(a @ b)
    if dot < 0:
        b, dot = -b, -dot
    angle = math.acos(min(dot, 1.0))
    if angle < 1e-6:
        return a if part < 0.5 else b
    found: Floats = (math.sin((1 - part) * angle) * a + math.sin(part * angle) * b) / math.sin(angle)
    return found / np.linalg.norm(found)


class Frames:
    """A tree of frames, fed by transforms and by odometry, which says nothing where transforms do."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def add(
        self, parent: str, child: str, stamp_ns: int, pose: Rigid, *, static: bool = False, odometry: bool = False
    ) -> None:
        """Take a transform: the pose of ``child`` in ``parent`` at a time (ns)."""
        link = self._links.get(child)
        if link is not None and odometry and not link.odometry:
            return
        if link is None or (link.parent, link.static, link.odometry) != (parent, static, odometry):
            link = self._links[child] = _Link(parent, static, odometry)
        link.add(stamp_ns, pose)

    def lookup(self, target: str, source: str, stamp_ns: int) -> Rigid:
        """The transform from a frame into another at a time (ns).

        Raises:
            LateError: it is not known yet.
            MessageError: it will never be: the time is before all that is known.

        """
        up = self._to_root(source, target)
        if up[-1] == target:
            return self._along(up, stamp_ns)
        down = self._to_root(target, source)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            raise NoPathError(target, source)
        there = self._along(down[: down.index(common) + 1], stamp_ns)
        return there.inverse @ self._along(up[: up.index(common) + 1], stamp_ns)

    def _to_root(self, frame: str, until: str) -> list[str]:
        found = [frame]
        while found[-1] != until and found[-1] in self._links and self._links[found[-1]].parent not in found:
            found.append(self._links[found[-1]].parent)
        return found

    def _along(self, chain: list[str], stamp_ns: int) -> Rigid:
        pose = IDENTITY
        for frame in chain[:-1]:
            pose = self._links[frame].at(stamp_ns, frame) @ pose
        return pose
