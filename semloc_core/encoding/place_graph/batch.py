"""What every encoder reads.

A `Batch` is a disjoint union of one small graph per query place. Nodes are sorted by how many hops they are from
their query place and edges by that of their target, so that a layer which needs less takes a prefix
(``nodes_within``, ``edges_within``): that is what makes one query cheap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from semloc_core.errors import LabelspaceError
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class Batch:
    """B query places (*roots*) and their surroundings: N nodes, E directed edges (source sends to target).

    Args:
        features: (N, C) float32; an object's row is its class one-hot, a place's row is zero ("aggregation point").
            Objects of a class that the labelspace lacks are left out, or in a whole-graph batch have no edges.
        edge_index: (2, E) int64, sources over targets.
        edge_length: (E,) float32, metres: Euclidean for a traversability edge, geodesic between a place and an object.
        is_object: (N,) bool.
        graph: (N,) int64, which root's graph a node belongs to (all 0 … B-1; in a whole-graph batch all zero).
        n_roots: B; the roots are nodes 0 … B-1.
        nodes_within: nodes_within[h] = how many nodes (a prefix) are at most h hops from their root, h = 0 … H.
        edges_within: edges_within[h] = how many edges (a prefix) have a target at most h hops from its root,
            h = 0 … H-1.
        node_ids: N ids, of places and objects.
        free_space: (B, R) float32, m² of free space around each root in R bands of distance
            (`semloc_core.encoding.place_graph.free_space`); None unless the encoder asks for it.
        kinds: (N,) int64, 0 for a place and 1 + class for an object, where ``features`` says just that; else None.

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
    free_space: Tensor | None = None
    kinds: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        n, e = self.features.shape[0], self.edge_index.shape[1]
        assert self.features.dtype == torch.float32, self.features.dtype
        assert self.edge_index.dtype == torch.int64, self.edge_index.dtype
        assert self.edge_index.shape == (2, e), self.edge_index.shape
        assert self.edge_length.shape == (e,), self.edge_length.shape
        assert self.is_object.shape == (n,), self.is_object.shape
        assert self.graph.shape == (n,), self.graph.shape
        assert len(self.node_ids) == n, (len(self.node_ids), n)
        assert self.nodes_within[0] == self.n_roots, (self.nodes_within, self.n_roots)
        assert self.nodes_within[-1] == n, (self.nodes_within, n)
        assert len(self.edges_within) == len(self.nodes_within) - 1, (self.nodes_within, self.edges_within)
        if self.free_space is not None:
            assert self.free_space.dtype == torch.float32, self.free_space.dtype
            assert self.free_space.ndim == 2, self.free_space.shape
            assert self.free_space.shape[0] == self.n_roots, (self.free_space.shape, self.n_roots)
        assert self.kinds is None or self.kinds.shape == (n,), self.kinds.shape
        assert self.edges_within == () or self.edges_within[-1] == e, (self.edges_within, e)

    @property
    def n_nodes(self) -> int:
        """N."""
        return int(self.features.shape[0])

    def with_features(self, features: Tensor) -> Batch:
        """The same graph with other node features (N, C)."""
        return replace(self, features=features, kinds=None)


def batch_of_arrays(
    classes: NDArray[np.int64],
    n_classes: int,
    is_object: NDArray[np.bool_],
    edges: NDArray[np.int64],
    lengths: NDArray[np.float64],
    graph: NDArray[np.int64],
    nodes_within: Sequence[int],
    edges_within: Sequence[int],
    node_ids: Sequence[str],
    kinds: NDArray[np.int64] | None = None,
) -> Batch:
    """Make a batch from arrays that are sorted already; for those who extract.

    Args:
        classes: (N,) class index, -1 for places and classes that the labelspace lacks.
        n_classes: C.
        is_object: (N,).
        edges: (2, E) sources over targets.
        lengths: (E,) metres.
        graph: (N,) as in `Batch`.
        nodes_within: as in `Batch`.
        edges_within: as in `Batch`.
        node_ids: N ids.
        kinds: as in `Batch`.

    Raises:
        LabelspaceError: a class index is not below ``n_classes``.

    """
    if len(classes) and int(classes.max()) >= n_classes:
        raise LabelspaceError(f"expected class indices below {n_classes} (got {int(classes.max())})")
    known = np.flatnonzero(classes >= 0)
    features = np.zeros((len(classes), n_classes), dtype=np.float32)
    features[known, classes[known]] = 1.0
    return Batch(
        features=torch.from_numpy(features),
        edge_index=torch.from_numpy(np.ascontiguousarray(edges)),
        edge_length=torch.from_numpy(lengths.astype(np.float32)),
        is_object=torch.from_numpy(is_object),
        graph=torch.from_numpy(graph),
        n_roots=nodes_within[0],
        nodes_within=tuple(nodes_within),
        edges_within=tuple(edges_within),
        node_ids=tuple(node_ids),
        kinds=kinds,
    )
