"""Places and what is around them, as tensors: the input of every encoder.

A `Batch` is a disjoint union of one small graph per query place. Nodes are sorted by how many hops they are from
their query place and edges by that of their target, so that a layer which needs less takes a prefix
(``nodes_within``, ``edges_within``): that is what makes one query cheap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Batch:
    """B query places (*roots*) and their surroundings: N nodes, E directed edges (source sends to target).

    Args:
        features: (N, C) float32; an object's row is its class one-hot, a place's row is zero ("aggregation point"),
            and so is that of an object whose class the labelspace does not have.
        edge_index: (2, E) int64, sources over targets.
        edge_length: (E,) float32, metres along traversability edges.
        is_object: (N,) bool.
        graph: (N,) int64, which root's graph a node belongs to (all 0 … B-1; in a whole-graph batch all zero).
        n_roots: B; the roots are nodes 0 … B-1.
        nodes_within: nodes_within[h] = how many nodes (a prefix) are at most h hops from their root, h = 0 … H.
        edges_within: edges_within[h] = how many edges (a prefix) have a target at most h hops from its root,
            h = 0 … H-1.
        node_ids: N ids, of places and objects.

    """

    features: Tensor
    edge_index: Tensor
    edge_length: Tensor
    is_object: Tensor
    graph: Tensor
    n_roots: int
    nodes_within: tuple[int, ...]
    edges_within: tuple[int, ...]
    node_ids: tuple[str, ...]

    def __post_init__(self) -> None:
        n, e = self.features.shape[0], self.edge_index.shape[1]
        assert self.features.dtype == torch.float32, self.features.dtype
        assert self.edge_index.dtype == torch.int64, self.edge_index.dtype
        assert self.edge_index.shape == (2, e), self.edge_index.shape
        assert self.edge_length.shape == (e,), self.edge_length.shape
        assert self.is_object.shape == (n,), self.is_object.shape
        assert self.graph.shape == (n,), self.graph.shape
        assert len(self.node_ids) == n, (len(self.node_ids), n)
        assert self.nodes_within[-1] == n, (self.nodes_within, n)
        assert self.edges_within == () or self.edges_within[-1] == e, (self.edges_within, e)

    @property
    def n_nodes(self) -> int:
        """N."""
        return int(self.features.shape[0])

    def with_features(self, features: Tensor) -> Batch:
        """The same graph with other node features (N, C)."""
        return replace(self, features=features)
