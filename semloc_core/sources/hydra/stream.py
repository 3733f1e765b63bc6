"""What Hydra publishes (`hydra_msgs/DsgUpdate`), as scene-graph updates; takes the package spark_dsg. No ROS here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import msgspec

from semloc_core.errors import SemlocError
from semloc_core.graph import GraphDeltas, Reading, SceneGraph
from semloc_core.sources.hydra.file import AgentPose, HydraFile
from semloc_core.sources.hydra.read import from_spark_dsg
from semloc_core.wire import Odometry, SceneGraphUpdate

DSG_UPDATE = "hydra_msgs/msg/DsgUpdate"


class DsgStream:
    """Hydra's messages to updates.

    Args:
        reading: what is said of class ids besides the graph's own names.
        full_every_s: seconds between full updates, by the messages' stamps.
        robot: whose latest pose is the query place (see `AgentPose.robot`); None: the first robot's that has any.

    """

    def __init__(self, reading: Reading | None, full_every_s: float, robot: str | None = None) -> None:
        self._reading, self._robot = reading, robot
        self._full_every_ns = round(full_every_s * 1e9)
        self._deltas = GraphDeltas()
        self._full_ns: int | None = None
        self._graph: SceneGraph | None = None
        self._agents: dict[str, AgentPose] = {}
        self._number = 0
        self.dropped: dict[str, int] = {}
        """What of the latest message could not be used: reason -> how many nodes and edges."""
        self.said: tuple[str, ...] = ()
        """What is to be said of the latest message, see `HydraFile.said`."""
        self.robots: set[str] = set()
        """Robots whose poses came."""

    def update(
        self,
        contents: bytes,
        full: bool,
        stamp_ns: int,
        frame_id: str,
        deleted_nodes: Iterable[int] = (),
        deleted_edges: Iterable[int] = (),
        number: int = 0,
    ) -> SceneGraphUpdate | None:
        """Take a message in.

        Args:
            contents: spark_dsg's binary form.
            full: it is the whole graph; else what is new in it, and the rest stays as it is. Hydra itself sends
                nothing but whole graphs.
            stamp_ns: of the message.
            frame_id: of the positions.
            deleted_nodes: ids of nodes that are gone, where it is not the whole graph.
            deleted_edges: likewise; the ends of one edge after those of the other.
            number: counts messages; 0 where the sender does not count.

        Returns:
            The update to publish; None while there is no whole graph yet.

        Raises:
            SemlocError: spark_dsg can't read it, it does not fit the graph, or one before it was lost: there is no
                graph until the next whole one.

        """
        known, last = self._graph, self._number
        if not full and known is None:
            return None
        self._graph, self._number = None, number  # for good, if anything below fails
        if not full and number and number != last + 1:
            raise SemlocError(f"expected change {last + 1} of the scene graph (got {number}): waiting for a whole one")
        part = self._read(contents, full)
        self.dropped, self.said = part.dropped, part.said
        agents = {agent.id: agent for agent in part.agents}
        if full or known is None:
            self._graph, self._agents = part.graph, agents
        else:
            gone = [str(node) for node in deleted_nodes]
            ends = [str(node) for node in deleted_edges]
            self._graph = amended(known, part.graph, gone, list(zip(ends[::2], ends[1::2], strict=False)))
            self._agents = {i: a for i, a in self._agents.items() if i not in gone} | agents
        self.robots.update(agent.robot for agent in part.agents)
        if self._robot is None and self.robots:
            self._robot = min(self.robots)
        mine = {i: agent for i, agent in self._agents.items() if agent.robot == self._robot}
        before = self._full_ns
        due = before is None or not before <= stamp_ns < before + self._full_every_ns
        if due:
            self._full_ns = stamp_ns
        update = self._deltas.update(self._graph, stamp_ns, frame_id, query_place(self._graph, mine), full=due)
        return msgspec.structs.replace(update, odometry=odometry(mine, frame_id))

    def ask_full(self) -> None:
        """Have the next update be a full one."""
        self._full_ns = None

    def _read(self, contents: bytes, whole: bool) -> HydraFile:
        import spark_dsg

        try:
            graph = spark_dsg.DynamicSceneGraph.from_binary(contents)
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            reason = " ".join(str(error).split())
            raise SemlocError(f"expected a scene graph in spark_dsg's binary form (got: {reason})") from error
        return from_spark_dsg(graph, self._reading, whole=whole)


def amended(
    graph: SceneGraph, part: SceneGraph, gone_nodes: list[str], gone_edges: list[tuple[str, str]]
) -> SceneGraph:
    """A graph with a part of it new, and some of it gone; the graph given is left as it is.

    Raises:
        GraphError: the part does not fit.

    """
    whole = SceneGraph.from_update(graph.to_update(0, 0, ""))
    change = part.to_update(0, 0, "")
    fields = {name: getattr(change, name) for name in change.__struct_fields__}
    news = fields | {"full": False, "removed_nodes": gone_nodes, "removed_edges": gone_edges}
    whole.apply(SceneGraphUpdate(**news))
    return whole


def query_place(graph: SceneGraph, agents: Mapping[str, AgentPose]) -> str | None:
    """The place of the latest agent pose: as the graph says, else the nearest one; None without poses or places."""
    latest = _latest(agents)
    if latest is None or not graph.places:
        return None
    if latest.place is not None and latest.place in graph.places:
        return latest.place
    x, y, z = latest.position
    return min(
        graph.places.items(),
        key=lambda item: ((item[1][0] - x) ** 2 + (item[1][1] - y) ** 2 + (item[1][2] - z) ** 2, item[0]),
    )[0]


def odometry(agents: Mapping[str, AgentPose], frame_id: str) -> Odometry | None:
    """The latest agent pose, which Hydra gives in the frame of the graph; None without one that has a heading."""
    latest = _latest(agents)
    if latest is None or latest.orientation_xyzw is None:
        return None
    return Odometry(latest.position, latest.orientation_xyzw, frame_id)


def _latest(agents: Mapping[str, AgentPose]) -> AgentPose | None:
    return max(agents.values(), key=lambda pose: (pose.stamp_ns, int(pose.id)), default=None)
