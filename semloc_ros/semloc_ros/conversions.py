# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Between semloc's types and ROS messages. Pure functions; nothing else in the package converts."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, PoseWithCovarianceStamped, Quaternion, TransformStamped, Vector3
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

from semloc_core import wire
from semloc_core.wire import Position, orientation_of, quaternion_of, ros_covariance
from semloc_ros.diagnostics import Line
from semloc_ros.tf import Stamped

NS_PER_S = 1_000_000_000


def time_msg(stamp_ns: int) -> Time:
    """Nanoseconds as a ROS time; clamped to what that can hold (32 bits of seconds)."""
    stamp_ns = max(-(2**31) * NS_PER_S, min(stamp_ns, 2**31 * NS_PER_S - 1))
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def stamp_ns(stamp: Time) -> int:
    """A ROS time as nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def header(stamp_ns: int, frame_id: str) -> Header:
    """A header."""
    return Header(stamp=time_msg(stamp_ns), frame_id=frame_id)


def point(position: Position) -> Point:
    """A position, metres."""
    x, y, z = position
    return Point(x=float(x), y=float(y), z=float(z))


def string(message: msgspec.Struct) -> String:
    """A message of the contract as JSON in a String."""
    return String(data=wire.encode(message).decode())


def matches_string(matches: wire.PlaceMatches, latency_ms: float) -> String:
    """Matches as published: with the time from the update's arrival to now."""
    return string(msgspec.structs.replace(matches, latency_ms=latency_ms))


def quaternion(orientation_xyzw: Sequence[float]) -> Quaternion:
    """A unit quaternion (x, y, z, w)."""
    x, y, z, w = orientation_xyzw
    return Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))


def pose_msg(
    pose: wire.Pose, odometry: wire.Odometry | None, stamp_ns: int, frame_id: str
) -> PoseWithCovarianceStamped:
    """A pose, leaning as the odometry says; where its heading is not known, without a turn."""
    message = PoseWithCovarianceStamped(header=header(stamp_ns, frame_id))
    message.pose.pose.position = point(pose.position)
    message.pose.pose.orientation = quaternion(orientation_of(pose, odometry))
    message.pose.covariance = ros_covariance(pose)
    return message


def tf_msg(stamped: Stamped) -> TFMessage:
    """A transform as tf2 takes it."""
    message = TransformStamped(header=header(stamped.stamp_ns, stamped.parent), child_frame_id=stamped.child)
    x, y, z = stamped.transform.translation
    message.transform.translation = Vector3(x=float(x), y=float(y), z=float(z))
    message.transform.rotation = quaternion(quaternion_of(stamped.transform.yaw))
    return TFMessage(transforms=[message])


def pose_stamped(position: Position, orientation_xyzw: Sequence[float], stamp_ns: int, frame_id: str) -> PoseStamped:
    """A pose with its time and frame."""
    message = PoseStamped(header=header(stamp_ns, frame_id))
    message.pose.position, message.pose.orientation = point(position), quaternion(orientation_xyzw)
    return message


LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warn": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
    "stale": DiagnosticStatus.STALE,
}


def diagnostics_msg(lines: Sequence[Line], name: str, stamp: Time) -> DiagnosticArray:
    """Diagnostics of the node ``name``."""
    return DiagnosticArray(
        header=Header(stamp=stamp),
        status=[
            DiagnosticStatus(
                level=LEVELS[line.level],
                name=f"{name}: {line.name}",
                hardware_id=name,
                message=line.message,
                values=[KeyValue(key=key, value=value) for key, value in line.values.items()],
            )
            for line in lines
        ],
    )
