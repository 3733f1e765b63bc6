"""Disjoint unions of batches that stay sorted by hop, so that a layer can still take a prefix."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
from torch import Tensor

from semloc_core.encoding.place_graph.batch import Batch
from semloc_core.errors import GraphError


def repeat(batch: Batch, k: int) -> tuple[Batch, Tensor]:
    """The disjoint union of ``k`` copies, for encoding one batch under many features or masks at once.

    Args:
        batch: N nodes, B roots.
        k: number of copies, at least 1.

    Returns:
        The union: root b of copy c is root c·B + b. And (k, N) int64: row of copy c of node n in it, by which
        features or masks (k, N, …) are scattered: ``out[rows] = of_copies``.

    """
    if k < 1:
        raise GraphError(f"expected at least one copy of a batch (got {k})")
    rows = _rows_of_copies(batch.nodes_within, k)
    edge_rows = _rows_of_copies(batch.edges_within, k)
    n, e = batch.n_nodes, batch.edge_index.shape[1]
    of_node = torch.empty(k * n, dtype=torch.int64)
    of_node[rows.view(-1)] = torch.arange(n).repeat(k)
    of_edge = torch.empty(k * e, dtype=torch.int64)
    of_edge[edge_rows.view(-1)] = torch.arange(e).repeat(k)
    device = batch.features.device
    edge_index = torch.empty((2, k * e), dtype=torch.int64)
    edge_index[:, edge_rows.view(-1)] = rows[:, batch.edge_index.cpu()].transpose(0, 1).reshape(2, -1)
    graph = torch.empty(k * n, dtype=torch.int64)
    copies = torch.arange(k)[:, None] * _n_graphs(batch)
    graph[rows.view(-1)] = (batch.graph.cpu() + copies).view(-1)
    of_node, of_edge = of_node.to(device), of_edge.to(device)
    starts = (0, *batch.nodes_within[:-1])
    union = Batch(
        features=batch.features[of_node],
        edge_index=edge_index.to(device),
        edge_length=batch.edge_length[of_edge],
        is_object=batch.is_object[of_node],
        graph=graph.to(device),
        n_roots=k * batch.n_roots,
        nodes_within=tuple(k * count for count in batch.nodes_within),
        edges_within=tuple(k * count for count in batch.edges_within),
        free_space=None if batch.free_space is None else batch.free_space.repeat(k, 1),
        node_ids=sum((batch.node_ids[a:b] * k for a, b in zip(starts, batch.nodes_within, strict=True)), ()),
    )
    return union, rows.to(device)


def union(batches: Sequence[Batch]) -> tuple[Batch, tuple[Tensor, ...]]:
    """The disjoint union of batches of the same number of hops and classes.

    Returns:
        The union, its roots those of the first batch, then of the second, and so on; and for each batch (N,) int64:
        the rows of its nodes in the union.

    Raises:
        GraphError: no batch, or batches that differ in hops or classes.

    """
    kinds = {(len(batch.nodes_within), batch.features.shape[1]) for batch in batches}
    measured = {batch.free_space is not None for batch in batches}
    if len(kinds) != 1:
        raise GraphError(f"expected batches of the same hops and classes (got {sorted(kinds)})")
    if len(measured) != 1:
        raise GraphError("expected free space of all batches or of none (got some with and some without)")
    rows = _rows_of_parts([batch.nodes_within for batch in batches])
    edge_rows = _rows_of_parts([batch.edges_within for batch in batches])
    first_graph = [0, *accumulate(_n_graphs(batch) for batch in batches)]
    node_order = torch.argsort(torch.cat(rows))
    edge_order = torch.argsort(torch.cat(edge_rows))
    ids = [node for batch in batches for node in batch.node_ids]
    device = batches[0].features.device
    rows = [row.to(device) for row in rows]
    edges = [row[batch.edge_index] for row, batch in zip(rows, batches, strict=True)]
    graphs = [batch.graph + first for batch, first in zip(batches, first_graph, strict=False)]
    by_node, by_edge = node_order.to(device), edge_order.to(device)
    spaces = [batch.free_space for batch in batches if batch.free_space is not None]
    joined = Batch(
        features=torch.cat([batch.features for batch in batches])[by_node],
        edge_index=torch.cat(edges, dim=1)[:, by_edge],
        edge_length=torch.cat([batch.edge_length for batch in batches])[by_edge],
        is_object=torch.cat([batch.is_object for batch in batches])[by_node],
        graph=torch.cat(graphs)[by_node],
        n_roots=sum(batch.n_roots for batch in batches),
        nodes_within=_totals([batch.nodes_within for batch in batches]),
        edges_within=_totals([batch.edges_within for batch in batches]),
        node_ids=tuple(ids[i] for i in node_order.tolist()),
        free_space=torch.cat(spaces) if len(spaces) == len(batches) else None,
    )
    return joined, tuple(rows)


def _n_graphs(batch: Batch) -> int:
    """B, or 1 for a whole-graph batch."""
    return int(batch.graph[: batch.n_roots].max()) + 1 if batch.n_roots else 0


def _totals(within: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    return tuple(map(sum, zip(*within, strict=True)))


def _rows_of_copies(within: tuple[int, ...], k: int) -> Tensor:
    """(k, N) where item n of copy c goes when each level (prefix counts ``within``) is repeated k times in place."""
    counts = torch.tensor((0, *within), dtype=torch.int64)
    size, start = counts.diff(), counts[:-1]
    base = torch.arange(int(counts[-1])) + ((k - 1) * start).repeat_interleave(size)
    return base + torch.arange(k)[:, None] * size.repeat_interleave(size)


def _rows_of_parts(within: Sequence[tuple[int, ...]]) -> list[Tensor]:
    """For each part, where its items go when the parts are joined level by level."""
    sizes = torch.tensor([(0, *part) for part in within], dtype=torch.int64).diff(dim=1)  # (parts, levels)
    start = sizes.sum(dim=0).cumsum(0) - sizes.sum(dim=0) + sizes.cumsum(0) - sizes
    own_start = sizes.cumsum(1) - sizes
    return [
        torch.arange(int(size.sum())) + (to - own).repeat_interleave(size)
        for size, to, own in zip(sizes, start, own_start, strict=True)
    ]
