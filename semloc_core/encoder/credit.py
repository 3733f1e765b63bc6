"""Attention rollout: how much of a place's attention comes from each object, also through places between."""

from __future__ import annotations

import torch
from torch import Tensor

from semloc_core.encoder.gatv2 import Attention
from semloc_core.encoder.layers import TrimmedEdges
from semloc_core.place_graph import Batch


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
    source, target = edges.reaching(0)
    given = attention.edges.mean(1)
    credit = given.new_zeros(nodes[1]).index_add_(0, source, given)
    if attention.self_loops is not None:
        credit[:roots] += attention.self_loops.mean(1)
    else:
        credit[:roots] += given.new_ones(roots).index_fill_(0, target, 0.0)

    source, target = edges.reaching(layers - 1)
    inputs = given.new_ones(nodes[layers - 1]).index_add_(0, target, given.new_ones(target.shape[0]))
    for hops in range(1, layers):  # the layer that computed rows within `hops`, from rows within `hops + 1`
        source, target = edges.reaching(hops)
        is_object = batch.is_object[: nodes[hops]]
        share = (credit / inputs[: nodes[hops]]).masked_fill(is_object, 0.0)
        passed = credit.new_zeros(nodes[hops + 1])
        passed[: nodes[hops]] = torch.where(is_object, credit, share)
        credit = passed.index_add_(0, source, share.index_select(0, target))

    is_object = batch.is_object[: nodes[layers]]
    on_places = credit.masked_fill(is_object, 0.0)
    self_share = credit.new_zeros(roots).index_add_(0, batch.graph[: nodes[layers]], on_places)
    result = credit.new_zeros(batch.n_nodes)
    result[: nodes[layers]] = credit.masked_fill(~is_object, 0.0)
    return result, self_share
