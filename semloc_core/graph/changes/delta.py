"""Updates out of whole graphs: for sources that publish their graph again and again, such as Hydra."""

from __future__ import annotations

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import SceneGraphUpdate


def delta(
    before: SceneGraph, after: SceneGraph, seq: int, stamp_ns: int, frame_id: str, query_place: str | None
) -> SceneGraphUpdate:
    """The delta that makes ``after`` of ``before``.

    An object whose sightings, or whose kind, changed is removed and given again, as `SceneGraph.apply` wants it.

    Args:
        before: the graph that the receiver has.
        after: the graph that it is to have.
        seq: of the message.
        stamp_ns: of the message.
        frame_id: of the positions.
        query_place: where the robot is, in ``after``.

    """
    whole = after.to_update(seq, stamp_ns, frame_id, query_place)
    again = {
        node
        for node in after.objects
        if node in before.objects and before.sightings.get(node, set()) - after.sightings.get(node, set())
    }
    gone = {
        node for node in [*before.places, *before.objects] if node not in after.places and node not in after.objects
    }
    gone |= {node for node in before.places if node in after.objects}
    gone |= {node for node in before.objects if node in after.places} | again
    had, has = _edges(before), {(min(edge), max(edge)) for edge in whole.edges}
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        seq=seq,
        full=False,
        places=[p for p in whole.places if p.id in gone or before.places.get(p.id) != p.position],
        objects=[o for o in whole.objects if o.id in gone or before.objects.get(o.id) != o],
        edges=[e for e in whole.edges if (min(e), max(e)) not in had or not gone.isdisjoint(e)],
        query_place=whole.query_place if query_place is None else query_place,
        sightings=[s for s in whole.sightings if s[1] in again or s[0] not in before.sightings.get(s[1], set())],
        removed_nodes=sorted(gone),
        removed_edges=sorted(e for e in had - has if gone.isdisjoint(e)),
    )


def _edges(graph: SceneGraph) -> set[tuple[str, str]]:
    found = {(a, b) for a, row in graph.neighbours.items() for b in row if a < b}
    return found | {(min(p, o), max(p, o)) for o, parents in graph.parents.items() for p in parents}


class GraphDeltas:
    """Numbers the updates of a source, and remembers what its receivers have."""

    def __init__(self) -> None:
        self._before: SceneGraph | None = None
        self._seq = -1

    def update(
        self, graph: SceneGraph, stamp_ns: int, frame_id: str, query_place: str | None, *, full: bool = False
    ) -> SceneGraphUpdate:
        """The next update.

        Args:
            graph: the source's graph now; not changed any more.
            stamp_ns: of the message.
            frame_id: of the positions.
            query_place: where the robot is.
            full: a full update; the first one always is.

        """
        before, self._before = self._before, graph
        self._seq += 1
        if full or before is None:
            return graph.to_update(self._seq, stamp_ns, frame_id, query_place)
        return delta(before, graph, self._seq, stamp_ns, frame_id, query_place)
