"""Attention rollout: how much of a place's attention comes from each object, also through places between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from semloc_core.encoding.encoder.layers import TrimmedEdges
from semloc_core.encoding.encoder.paper.gatv2 import Attention
from semloc_core.encoding.place_graph import Batch

Floats = NDArray[np.float64]


def roll_out(batch: Batch, edges: TrimmedEdges, attention: Attention) -> tuple[Tensor, Tensor]:
    """Follow the attention of the last layer back to the objects that it came from.

    1. The GATv2 attention of a root, averaged over heads, is credit given to each of its in-neighbours and,
       through the self-loop, to itself. It sums to 1. (Without self-loops, a root that nothing sends to keeps
       its 1 itself.)
    2. What reaches an object stops there.
    3. What reaches a place is passed on by each earlier message-passing layer, the last one first: in equal
       shares over that place's inputs, which are its in-neighbours and itself (the root weight), since a sum
       weighs each input alike. A place with k in-neighbours gives 1/(k+1) to each and keeps as much.
    4. What is still on places after the first layer is the root's ``self_share``.

    This is attention rollout (Abnar and Zuidema, "Quantifying Attention Flow in Transformers", ACL 2020) with the
    layers that have no attention taken as uniform, and objects absorbing. Credits of one root's graph and its
    ``self_share`` sum to 1.

    Args:
        batch: B places, each with a graph of its own.
        edges: the edges that the encoder read; ``len(edges.within)`` layers, GATv2 the last.
        attention: that of GATv2, on ``edges.reaching(0)``.

    Returns:
        credit (N,) float32, zero for places, and self_share (B,) float32.

    """
    weights, own = _numpy(attention.edges), attention.self_loops
    credit, self_share = follow(
        _numpy(batch.is_object),
        _numpy(batch.graph),
        batch.n_roots,
        batch.nodes_within,
        edges.within,
        _numpy(edges.source),
        _numpy(edges.target),
        weights,
        None if own is None else _numpy(own),
    )
    like = attention.edges
    return torch.from_numpy(credit).to(like), torch.from_numpy(self_share).to(like)


def follow(
    is_object: NDArray[np.bool_],
    graph: NDArray[np.int64],
    roots: int,
    nodes: Sequence[int],
    edges: Sequence[int],
    source: NDArray[np.int64],
    target: NDArray[np.int64],
    weights: NDArray[np.floating[Any]],
    own: NDArray[np.floating[Any]] | None,
) -> tuple[Floats, Floats]:
    """`roll_out` on arrays.

    In numpy: no gradient is wanted, and on graphs of this size its calls cost a fraction of torch's.

    Args:
        is_object: (N,).
        graph: (N,) which root each node belongs to.
        roots: B.
        nodes: nodes within 0 … H hops.
        edges: edges into nodes within 0 … layers-1 hops.
        source: (E,).
        target: (E,), ascending.
        weights: (E₀, heads) attention of the edges into roots.
        own: (B, heads) of the self-loops, or None.

    Returns:
        (N,) credit and (B,) self share.

    """
    layers = len(edges)
    count = edges[0]
    credit = _sums(source[:count], _mean_head(weights), nodes[1])
    if own is not None:
        credit[:roots] += _mean_head(own)
    else:
        credit[:roots] = np.where(np.bincount(target[:count], minlength=roots) == 0, 1.0, credit[:roots])

    inputs = 1.0 + np.bincount(target, minlength=nodes[layers - 1])
    for hops in range(1, layers):  # the layer that computed rows within `hops`, from rows within `hops + 1`
        n, count = nodes[hops], edges[hops]
        share = np.where(is_object[:n], 0.0, credit / inputs[:n])
        passed = _sums(source[:count], share[target[:count]], nodes[hops + 1])
        passed[:n] += np.where(is_object[:n], credit, share)
        credit = passed

    n = nodes[layers]
    self_share = _sums(graph[:n], np.where(is_object[:n], 0.0, credit), roots)
    result = np.zeros(len(is_object))
    result[:n] = np.where(is_object[:n], credit, 0.0)
    return result, self_share


def _sums(index: NDArray[np.int64], weight: Floats, n: int) -> Floats:
    """(n,) float64: the weights of each index added up (bincount gives integers where there is none)."""
    return np.bincount(index, weight, n).astype(np.float64, copy=False)


def _mean_head(attention: NDArray[np.floating[Any]]) -> Floats:
    """(E, heads) -> (E,) float64."""
    mean: Floats = attention.sum(1, dtype=np.float64) / attention.shape[1]
    return mean


def _numpy(tensor: Tensor) -> NDArray[Any]:
    array: NDArray[Any] = tensor.detach().cpu().numpy()
    return array
