"""A whole building as one graph, every place a root: what one pass of message passing embeds at once."""

from __future__ import annotations

import numpy as np

from semloc_core.encoding.place_graph.batch import Batch, batch_of_arrays
from semloc_core.graph import GraphArrays, visible_pairs


def whole_graph_batch(arrays: GraphArrays, n_classes: int, hops: int, radius_m: float) -> Batch:
    """All places (rows 0 … P-1), then all objects, joined by traversability and visibility edges, both ways.

    A place's surroundings in it are those of its ego graph (`ego_batch`), so an encoder of ``hops`` layers gives
    a place the same embedding from either. Objects of a class that the labelspace lacks have no edges.

    Args:
        arrays: the building.
        n_classes: C of the labelspace that ``arrays`` was made with.
        hops: H ≥ 0, how many layers will read it; with one, edges into objects are left out, with none all edges
            and the objects too.
        radius_m: visibility radius, metres.

    """
    p, o = arrays.n_places, arrays.n_objects
    place_to_place = arrays.place_edges
    visible, distances = visible_pairs(arrays, radius_m)
    known = arrays.object_classes[visible[1]] >= 0
    visible, distances = visible[:, known], distances[known]
    place_to_object = visible + np.array([[0], [p]])
    edges = np.concatenate([place_to_place, place_to_place[::-1], place_to_object, place_to_object[::-1]], axis=1)
    lengths = np.concatenate([np.tile(arrays.edge_lengths(), 2), np.tile(distances, 2)])
    order = np.argsort(edges[1] * (p + o) + edges[0])  # no key comes twice
    into_places = int((edges[1] < p).sum())
    n_nodes = p + o if hops else p
    n_edges = (0, into_places, edges.shape[1])[min(hops, 2)]
    order = order[:n_edges]
    classes = np.concatenate([np.full(p, -1, dtype=np.int64), arrays.object_classes])
    return batch_of_arrays(
        classes=classes[:n_nodes],
        n_classes=n_classes,
        is_object=np.arange(n_nodes) >= p,
        edges=edges[:, order],
        lengths=lengths[order],
        graph=np.zeros(n_nodes, dtype=np.int64),
        nodes_within=[p] + [n_nodes] * hops,
        edges_within=[into_places, *[n_edges] * (hops - 1)] if hops else [],
        node_ids=(arrays.place_ids + arrays.object_ids)[:n_nodes],
    )
