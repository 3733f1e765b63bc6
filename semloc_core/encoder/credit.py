"""Attention rollout: how much of a place's attention comes from each object, also through places between."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from semloc_core.encoder.gatv2 import Attention
from semloc_core.encoder.layers import TrimmedEdges
from semloc_core.place_graph import Batch

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
    layers, roots, nodes = len(edges.within), batch.n_roots, batch.nodes_within
    # in numpy: no gradient is wanted, and on graphs of this size its calls cost a fraction of torch's
    source, target = _numpy(edges.source), _numpy(edges.target)
    is_object, graph = _numpy(batch.is_object), _numpy(batch.graph)

    count = edges.within[0]
    credit = _sums(source[:count], _mean_head(attention.edges), nodes[1])
    if attention.self_loops is not None:
        credit[:roots] += _mean_head(attention.self_loops)
    else:
        credit[:roots] = np.where(np.bincount(target[:count], minlength=roots) == 0, 1.0, credit[:roots])

    inputs = 1.0 + np.bincount(target, minlength=nodes[layers - 1])
    for hops in range(1, layers):  # the layer that computed rows within `hops`, from rows within `hops + 1`
        n, count = nodes[hops], edges.within[hops]
        share = np.where(is_object[:n], 0.0, credit / inputs[:n])
        passed = _sums(source[:count], share[target[:count]], nodes[hops + 1])
        passed[:n] += np.where(is_object[:n], credit, share)
        credit = passed

    n = nodes[layers]
    self_share = _sums(graph[:n], np.where(is_object[:n], 0.0, credit), roots)
    result = np.zeros(batch.n_nodes)
    result[:n] = np.where(is_object[:n], credit, 0.0)
    like = attention.edges
    return torch.from_numpy(result).to(like), torch.from_numpy(self_share).to(like)


def _sums(index: NDArray[np.int64], weight: Floats, n: int) -> Floats:
    """(n,) float64: the weights of each index added up (bincount gives integers where there is none)."""
    return np.bincount(index, weight, n).astype(np.float64, copy=False)


def _mean_head(attention: Tensor) -> Floats:
    """(E, heads) -> (E,) float64."""
    mean: Floats = _numpy(attention).sum(1, dtype=np.float64) / attention.shape[1]
    return mean


def _numpy(tensor: Tensor) -> NDArray[Any]:
    array: NDArray[Any] = tensor.detach().cpu().numpy()
    return array
