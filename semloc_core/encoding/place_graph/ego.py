"""The surroundings of places by hops, out of a graph that changes: what message passing needs, and no more.

A robot asks at every update, and an update changes little. What is next to a node is laid out as an array when it is
first asked for and dropped when it changes, so that a query is a few calls of numpy on small integers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding.place_graph.batch import Batch, batch_of_arrays
from semloc_core.encoding.place_graph.combine import union
from semloc_core.errors import GraphError
from semloc_core.graph import Labelspace, SceneGraph, Visibility

Ints = NDArray[np.int64]
_Row = tuple[Ints, NDArray[np.float64]]


class EgoRows:
    """Ego graphs of one graph; tell it of every change.

    Args:
        graph: the scene graph.
        visibility: of that graph, up to date whenever a batch is asked for.
        labelspace: gives objects their class index; those of a class that it lacks are left out.

    """

    def __init__(self, graph: SceneGraph, visibility: Visibility, labelspace: Labelspace) -> None:
        self.visibility, self.labelspace = visibility, labelspace
        self._graph = graph
        self._slots: dict[str, int] = {}
        self._free: list[int] = []
        self._ids: list[str] = []
        self._rows: dict[int, _Row] = {}  # slot -> slots of its neighbours, metres
        self._kind = np.zeros(64, dtype=np.int64)  # slot -> 0 for a place, 1 + class for an object
        self._row = np.zeros(64, dtype=np.int64)  # slot -> row in the batch that is being made
        self._seen = np.zeros(64, dtype=np.int64)  # slot -> number of the last batch that it was in
        self._number = 0

    def forget(self, nodes: Iterable[str]) -> None:
        """Drop what is known of nodes that came, went or have other neighbours, objects or classes than before."""
        places, objects = self._graph.places, self._graph.objects
        for node in nodes:
            slot = self._slots.get(node)
            if slot is None:
                continue
            self._rows.pop(slot, None)
            if node in objects or node in places:
                self._kind[slot] = self._kind_of(node)
            else:
                del self._slots[node]
                self._free.append(slot)

    def batch(self, place: str | None, hops: int) -> Batch:
        """The ego graph of one place (None: of none): all nodes at most ``hops`` ≥ 0 hops away.

        Hops go over traversability and visibility edges. These run both ways, but those into the outermost nodes are
        left out: an encoder of as many layers has no use for them. Nodes are sorted by hop, then id; edges by target,
        then source: the result does not depend on the order in which nodes and edges came.

        Raises:
            GraphError: not a place of the graph.

        """
        if place is not None and place not in self._graph.places:
            raise GraphError(f"expected a place of the graph (got {place!r})")
        self._number += 1
        level = np.array([self._slot(place)] if place is not None else [], dtype=np.int64)
        levels, sources, lengths, counts, within, edges_within = [], [], [], [], [], []
        n_nodes = n_edges = 0
        for hop in range(hops + 1):
            levels.append(level)
            self._row[level] = np.arange(n_nodes, n_nodes + len(level))
            self._seen[level] = self._number
            n_nodes += len(level)
            within.append(n_nodes)
            if hop == hops:
                break
            rows = [self._rows.get(slot) or self._make(slot) for slot in level.tolist()]
            near = np.concatenate([row for row, _ in rows]) if rows else np.zeros(0, dtype=np.int64)
            sources.append(near)
            lengths += [length for _, length in rows]
            counts += [len(row) for row, _ in rows]
            n_edges += len(near)
            edges_within.append(n_edges)
            level = np.unique(near[self._seen[near] != self._number])
            level = level[self._by_id(level)]
        slots = np.concatenate(levels)
        kinds = self._kind[slots]
        source = self._row[np.concatenate(sources)] if sources else np.zeros(0, dtype=np.int64)
        target = np.repeat(np.arange(len(counts)), counts)
        order = np.argsort(target * n_nodes + source)  # no key comes twice
        length = np.concatenate(lengths) if lengths else np.zeros(0)
        return batch_of_arrays(
            classes=kinds - 1,
            n_classes=len(self.labelspace),
            is_object=kinds > 0,
            edges=np.stack([source[order], target]),
            lengths=length[order],
            graph=np.zeros(n_nodes, dtype=np.int64),
            nodes_within=within,
            edges_within=edges_within,
            node_ids=[self._ids[slot] for slot in slots.tolist()],
            kinds=kinds,
        )

    def _by_id(self, slots: Ints) -> list[int]:
        ids = [self._ids[slot] for slot in slots.tolist()]
        return sorted(range(len(ids)), key=ids.__getitem__)

    def _make(self, slot: int) -> _Row:
        """Look up what is next to a node."""
        node, graph = self._ids[slot], self._graph
        near: Mapping[str, float]
        if node in graph.objects:
            near = self.visibility.places_of(node)
        else:
            index, objects = self.labelspace.index, graph.objects
            seen = self.visibility.objects_of(node).items()
            near = graph.neighbours[node] | {id_: m for id_, m in seen if index(objects[id_].class_) >= 0}
        # `_slot` may give the arrays more room, so what is kept is slots and never a view of them.
        row = np.fromiter(map(self._slot, near), np.int64, len(near)), np.fromiter(near.values(), float, len(near))
        self._rows[slot] = row
        return row

    def _slot(self, node: str) -> int:
        slot = self._slots.get(node)
        if slot is None:
            slot = self._free.pop() if self._free else len(self._ids)
            if slot == len(self._ids):
                self._ids.append(node)
                if slot == len(self._kind):
                    self._kind, self._row, self._seen = (
                        np.concatenate([array, np.zeros_like(array)]) for array in (self._kind, self._row, self._seen)
                    )
            self._slots[node], self._ids[slot] = slot, node
            self._kind[slot] = self._kind_of(node)
        return slot

    def _kind_of(self, node: str) -> int:
        item = self._graph.objects.get(node)
        return 0 if item is None else 1 + self.labelspace.index(item.class_)


def ego_batch(
    graph: SceneGraph, visibility: Visibility, labelspace: Labelspace, places: Sequence[str], hops: int
) -> Batch:
    """Ego graphs of B places, of which the same one may come twice; see `EgoRows.batch`."""
    rows = EgoRows(graph, visibility, labelspace)
    batches = [rows.batch(place, hops) for place in places or (None,)]
    return batches[0] if len(batches) == 1 else union(batches)[0]
