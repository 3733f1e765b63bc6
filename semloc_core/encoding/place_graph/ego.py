"""The surroundings of places of the online graph, by hops: what message passing needs, and no more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from semloc_core.encoding.place_graph.batch import Batch, batch_of_arrays
from semloc_core.errors import GraphError
from semloc_core.graph import Labelspace, SceneGraph, Visibility


def ego_batch(
    graph: SceneGraph, visibility: Visibility, labelspace: Labelspace, places: Sequence[str], hops: int
) -> Batch:
    """Ego graphs: all nodes at most ``hops`` hops away over traversability and visibility edges.

    Edges run both ways, but those into the outermost nodes are left out: an encoder of as many layers has no use
    for them. Objects of a class that the labelspace lacks are left out. Nodes are sorted by hop, then graph, then
    id; edges by target, then source: the result does not depend on the order in which nodes and edges came.

    Args:
        graph: the scene graph.
        visibility: which places see which objects; up to date with the graph.
        labelspace: gives objects their class index.
        places: B root places; the same one may come twice.
        hops: H ≥ 0.

    Raises:
        GraphError: a root is not a place of the graph.

    """
    check_roots(graph, places)
    objects_of = _known_objects(graph, visibility, labelspace)
    levels: list[list[str]] = [[] for _ in range(hops + 1)]
    owners: list[list[int]] = [[] for _ in range(hops + 1)]
    rows: list[dict[str, int]] = []
    for number, root in enumerate(places):
        for hop, level in enumerate(_levels(graph, visibility, objects_of, root, hops)):
            levels[hop] += level
            owners[hop] += [number] * len(level)
        rows.append({})
    nodes = [node for level in levels for node in level]
    owner = [number for level in owners for number in level]
    for row, (node, number) in enumerate(zip(nodes, owner, strict=True)):
        rows[number][node] = row
    nodes_within = np.cumsum([len(level) for level in levels]).tolist()
    inner = nodes_within[hops - 1] if hops else 0

    sources: list[int] = []
    lengths: list[float] = []
    ends: list[int] = []
    neighbours, objects = graph.neighbours, graph.objects
    for node, number in zip(nodes[:inner], owner[:inner], strict=True):
        row_of = rows[number].__getitem__
        if node in objects:
            seen = visibility.places_of(node)
        else:
            near = neighbours[node]
            sources += map(row_of, near)
            lengths += near.values()
            seen = objects_of(node)
        sources += map(row_of, seen)
        lengths += seen.values()
        ends.append(len(sources))
    edge_ends = np.array(ends, dtype=np.int64)
    source = np.array(sources, dtype=np.int64)
    target = np.repeat(np.arange(inner), np.diff(edge_ends, prepend=0))
    order = np.argsort(target * len(nodes) + source)  # no key comes twice
    classes = np.array([labelspace.index(objects[n].class_) if n in objects else -1 for n in nodes], dtype=np.int64)
    return batch_of_arrays(
        classes=classes,
        n_classes=len(labelspace),
        is_object=classes >= 0,
        edges=np.stack([source[order], target[order]]),
        lengths=np.array(lengths, dtype=np.float64)[order],
        graph=np.array(owner, dtype=np.int64),
        nodes_within=nodes_within,
        edges_within=[ends[n - 1] if n else 0 for n in nodes_within[:hops]],
        node_ids=nodes,
        kinds=classes + 1,
    )


def check_roots(graph: SceneGraph, places: Sequence[str]) -> None:
    """Refuse roots that are not places of the graph (GraphError)."""
    for place in places:
        if place not in graph.places:
            raise GraphError(f"expected a place of the graph (got {place!r})")


def _known_objects(
    graph: SceneGraph, visibility: Visibility, labelspace: Labelspace
) -> Callable[[str], Mapping[str, float]]:
    """What a place sees of classes that the labelspace has."""
    objects, index = graph.objects, labelspace.index
    known: set[str] = set()  # an object is seen from many places: its class is looked up once

    def objects_of(place: str) -> Mapping[str, float]:
        seen = visibility.objects_of(place)
        if known.issuperset(seen):
            return seen
        known.update(node for node in seen if node not in known and index(objects[node].class_) >= 0)
        return seen if known.issuperset(seen) else {node: metres for node, metres in seen.items() if node in known}

    return objects_of


def _levels(
    graph: SceneGraph,
    visibility: Visibility,
    objects_of: Callable[[str], Mapping[str, float]],
    root: str,
    hops: int,
) -> list[list[str]]:
    """Breadth first: levels[h] holds the ids that are h hops from the root, sorted."""
    neighbours, objects = graph.neighbours, graph.objects
    frontier = [root]
    seen = {root}
    levels = [frontier]
    for _ in range(hops):
        reached: set[str] = set()
        for node in frontier:
            if node in objects:
                reached.update(visibility.places_of(node))
            else:
                reached.update(neighbours[node])
                reached.update(objects_of(node))
        reached -= seen
        seen |= reached
        frontier = sorted(reached)
        levels.append(frontier)
    return levels
