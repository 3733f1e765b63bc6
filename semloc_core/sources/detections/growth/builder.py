"""Detections, poses of the robot and, where there is one, an occupancy grid become a scene graph and its updates.

Places (`places.py`) and objects (`objects.py`) grow here; what has changed is written out (`written.py`). Whatever is
looked up is looked up in cells of a metre (`cells.py`): what a view costs does not depend on how large the graph is.
"""

from __future__ import annotations

from semloc_core.errors import ConfigError
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import Grid
from semloc_core.sources.detections.growth.cells import rounded
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.detections.growth.objects import Objects
from semloc_core.sources.detections.growth.places import Places
from semloc_core.sources.detections.growth.things import View, check_pose, checked
from semloc_core.sources.detections.growth.written import Written
from semloc_core.wire import Odometry, SceneGraphUpdate


class GraphBuilder:
    """A scene graph that grows as a robot looks around. The same input makes the same updates.

    Args:
        config: options.
        frame_id: of all poses and of the updates.

    """

    def __init__(self, config: BuilderConfig, frame_id: str) -> None:
        if not frame_id:
            raise ConfigError("expected a frame for the graph (got an empty name)")
        self.config, self.frame_id = config, frame_id
        self._places = Places(config)
        self._objects = Objects(config, self._places)
        self._written = Written(config, self._places, self._objects)
        self._robot: Rigid | None = None
        self._stamp_ns = 0
        self._seq = -1
        self._full_ns: int | None = None

    def ask_full(self) -> None:
        """Have the next update be a full one."""
        self._full_ns = None

    def walk(self, robot: Rigid, stamp_ns: int) -> None:
        """The robot is here (pose in the graph's frame, time in ns): a place, and a way to it, where there is none.

        Raises:
            MessageError: the pose is none.

        """
        check_pose(robot)
        self._robot, self._stamp_ns = robot, max(stamp_ns, self._stamp_ns)
        self._places.walk(robot.translation)

    def see(self, *views: View) -> None:
        """Take in what sensors saw, all or nothing.

        Raises:
            MessageError: a pose, size or score is none.

        """
        for view, seen in [(view, checked(view, self.config.min_score)) for view in views]:
            self.walk(view.robot, view.stamp_ns)
            self._objects.see(view, seen)

    def set_grid(self, grid: Grid) -> None:
        """Take an occupancy grid in the graph's frame: places over its free space, in place of the last one's.

        Where a place stays in its block it keeps its id. This costs the grid's size.

        Raises:
            GraphError: the robot fits nowhere in it; all is as it was.

        """
        height = float(self._robot.translation[2]) if self._robot is not None else 0.0
        if not self._places.set_grid(grid, height):
            return
        if self._robot is not None:
            self._places.walk(self._robot.translation)
        self._objects.hang_all()

    def update(self) -> SceneGraphUpdate:
        """What changed since the last update; everything, every few seconds and where `ask_full` asked for it."""
        stamp_ns, due = self._stamp_ns, self._full_ns
        full = due is None or stamp_ns >= due + round(self.config.full_every_s * 1e9)
        if full:
            self._full_ns = stamp_ns
        self._seq += 1
        changes = self._written.everything() if full else self._written.changes()
        return SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=stamp_ns,
            frame_id=self.frame_id,
            seq=self._seq,
            full=full,
            places=changes.places,
            objects=changes.objects,
            edges=changes.edges,
            query_place=self._places.here or None,
            removed_nodes=changes.removed_nodes,
            removed_edges=changes.removed_edges,
            odometry=self._odometry(),
        )

    def _odometry(self) -> Odometry | None:
        if self._robot is None:
            return None
        x, y, z, w = (round(float(value), 9) for value in self._robot.quaternion)
        return Odometry(rounded(self._robot.translation), (x, y, z, w), self.frame_id)
