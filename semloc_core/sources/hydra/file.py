"""What a Hydra file holds, once it has been read."""

from __future__ import annotations

from dataclasses import dataclass, field

from semloc_core.errors import ConfigError
from semloc_core.graph import INDEX_BITS, Labelspace, SceneGraph
from semloc_core.sources.hydra.write import Room
from semloc_core.text import short_repr
from semloc_core.wire import Position

FRAME_ID = "map"  # Hydra's; the files do not name theirs


def robot_of(node: str) -> str:
    """The robot that an agent's node id names: the letter in its top byte, or that byte's number."""
    prefix = int(node or 0) >> INDEX_BITS
    return chr(prefix) if 32 < prefix < 127 else str(prefix)


@dataclass(frozen=True)
class AgentPose:
    """Where the robot was.

    Args:
        stamp_ns: integer nanoseconds.
        position: metres.
        orientation_xyzw: unit quaternion; None where the file has none.
        id: node id; its top byte tells robots apart.
        place: the place that the file says the robot was at, or None.

    """

    stamp_ns: int
    position: Position
    orientation_xyzw: tuple[float, float, float, float] | None
    id: str = ""
    place: str | None = None

    @property
    def robot(self) -> str:
        """Whose pose it is: the letter of the id's top byte."""
        return robot_of(self.id)


@short_repr
@dataclass(frozen=True)
class HydraFile:
    """What a file holds.

    Args:
        graph: places, objects, and their edges.
        labelspace: the file's own: the names it brings along, else ``class_<id>`` of the ids that occur.
        agents: poses by rising time.
        rooms: node id -> room.
        dropped: reason -> how many nodes and edges could not be used.
        reversed: edges between layers that ran from child to parent; they are used.
        decided: a line for each thing that had to be decided of its classes (`semloc_core.graph.labels.classes`).
        said: lines for the person on what was repaired, passed over or will hurt, without the file's name.
        frame_id: the frame of all positions.

    """

    graph: SceneGraph
    labelspace: Labelspace
    agents: list[AgentPose] = field(default_factory=list)
    rooms: dict[str, Room] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    reversed: int = 0
    decided: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    frame_id: str = FRAME_ID

    @property
    def robots(self) -> list[str]:
        """The robots whose poses the file has, sorted."""
        return sorted({pose.robot for pose in self.agents})

    def agents_of(self, robot: str | None = None) -> list[AgentPose]:
        """The poses of one robot; None: of the first.

        Raises:
            ConfigError: the file has no poses of that robot.

        """
        robots = self.robots
        if robot is not None and robot not in robots:
            raise ConfigError(
                f"expected a robot that the file has poses of (got {robot!r}; {', '.join(robots) or 'none'})"
            )
        return [pose for pose in self.agents if pose.robot == (robot or robots[0])]
