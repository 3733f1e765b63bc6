"""A bag of what a robot's cameras detect: detections, odometry and transforms as ROS messages."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from semloc_core.sources.bag import GROUND_TRUTH_TOPIC, BagWriter
from semloc_core.sources.bag.typed import DETECTIONS, GRID, ODOMETRY, TRANSFORMS, typestore
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import Grid
from semloc_core.sources.detections.growth.things import Detection
from semloc_core.sources.detections.simulate import Glance
from semloc_core.wire import quaternion_of

_NS_PER_S = 1_000_000_000
LATE_NS = 60_000_000
"""So long a detector takes: its message comes after the odometry of its stamp."""
WALLS_EVERY = 50
"""The grid is sent again after so many frames."""


def write_detections(
    path: str | Path, glances: Iterable[Glance], *, truth_frame: str = "map", grid: Grid | None = None
) -> int:
    """Record a run: detections, odometry and transforms, the grid where there is one, and the true poses.

    Args:
        path: a ``.mcap`` file, or a rosbag2 folder.
        glances: in order; consumed as they come.
        truth_frame: frame of the true poses, and of the grid.
        grid: walls.

    Returns:
        How many frames were written.

    Raises:
        BagError: the bag can't be written.

    """
    count, glances = 0, iter(glances)
    first = list(islice(glances, 1))  # what can't begin leaves no bag behind
    with BagWriter(path) as bag:
        for glance in chain(first, glances):
            stamp_ns = glance.stamp_ns
            mounted = [(f"camera_{i}_optical_frame", mount) for i, (mount, _) in enumerate(glance.frames)]
            if count == 0:
                moved = [("base_link", frame, mount) for frame, mount in mounted]
                _write(bag, "/tf_static", TRANSFORMS, stamp_ns, _transforms(stamp_ns, moved))
            if grid is not None and count % WALLS_EVERY == 0:
                _write(bag, "/grid", GRID, stamp_ns, _grid(stamp_ns, "odom", grid))
            bag.write_pose(GROUND_TRUTH_TOPIC, stamp_ns, truth_frame, glance.position, quaternion_of(glance.heading))
            _write(bag, "/odometry", ODOMETRY, stamp_ns, _odometry(stamp_ns, glance.odometry))
            moved = [("odom", "base_link", glance.odometry)]
            _write(bag, "/tf", TRANSFORMS, stamp_ns, _transforms(stamp_ns, moved))
            for (frame, _), (_, detections) in zip(mounted, glance.frames, strict=True):
                late = stamp_ns + LATE_NS
                _write(bag, "/detections", DETECTIONS, late, detection_array(stamp_ns, frame, detections))
            count += 1
    return count


def _write(bag: BagWriter, topic: str, type_: str, stamp_ns: int, message: Any) -> None:
    bag.write(topic, type_, stamp_ns, bytes(typestore().serialize_cdr(message, type_)))


def _make(type_: str, **fields: Any) -> Any:
    return typestore().types[type_](**fields)


def _header(stamp_ns: int, frame_id: str) -> Any:
    time = _make("builtin_interfaces/msg/Time", sec=stamp_ns // _NS_PER_S, nanosec=stamp_ns % _NS_PER_S)
    return _make("std_msgs/msg/Header", stamp=time, frame_id=frame_id)


def _vector(values: Iterable[float], type_: str = "Vector3") -> Any:
    x, y, z = (float(value) for value in values)
    return _make(f"geometry_msgs/msg/{type_}", x=x, y=y, z=z)


def _turn(pose: Rigid) -> Any:
    x, y, z, w = pose.quaternion.tolist()
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(pose: Rigid) -> Any:
    return _make("geometry_msgs/msg/Pose", position=_vector(pose.translation, "Point"), orientation=_turn(pose))


def _with_covariance(pose: Rigid) -> Any:
    return _make("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=np.zeros(36))


def detection_array(stamp_ns: int, frame: str, detections: Iterable[Detection]) -> Any:
    """Detections as a vision_msgs/Detection3DArray."""
    header = _header(stamp_ns, frame)
    found = []
    for one in detections:
        results = [
            _make(
                "vision_msgs/msg/ObjectHypothesisWithPose",
                hypothesis=_make("vision_msgs/msg/ObjectHypothesis", class_id=name, score=score),
                pose=_with_covariance(one.pose),
            )
            for name, score in one.scores.items()
        ]
        box = _make("vision_msgs/msg/BoundingBox3D", center=_pose(one.pose), size=_vector(one.size or (0.0, 0.0, 0.0)))
        found.append(_make("vision_msgs/msg/Detection3D", header=header, results=results, bbox=box, id=one.track))
    return _make(DETECTIONS, header=header, detections=found)


def _odometry(stamp_ns: int, pose: Rigid) -> Any:
    twist = _make("geometry_msgs/msg/Twist", linear=_vector((0, 0, 0)), angular=_vector((0, 0, 0)))
    still = _make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
    return _make(
        ODOMETRY,
        header=_header(stamp_ns, "odom"),
        child_frame_id="base_link",
        pose=_with_covariance(pose),
        twist=still,
    )


def _transforms(stamp_ns: int, moved: Iterable[tuple[str, str, Rigid]]) -> Any:
    found = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(stamp_ns, parent),
            child_frame_id=child,
            transform=_make("geometry_msgs/msg/Transform", translation=_vector(pose.translation), rotation=_turn(pose)),
        )
        for parent, child, pose in moved
    ]
    return _make(TRANSFORMS, transforms=found)


def _grid(stamp_ns: int, frame: str, grid: Grid) -> Any:
    height, width = grid.cells.shape
    x, y, yaw = grid.origin
    info = _make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=_header(stamp_ns, frame).stamp,
        resolution=grid.resolution,
        width=width,
        height=height,
        origin=_pose(Rigid.of((x, y, 0.0), quaternion_of(yaw))),
    )
    return _make(GRID, header=_header(stamp_ns, frame), info=info, data=grid.cells.ravel())
