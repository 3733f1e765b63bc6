"""The paper's encoder on one place, in numpy: what a robot asks at every update.

The same function as `semloc_core.encoding.encoder.paper.encoder.PaperEncoder`, which stays the one that says what it
is; a test holds the two together. On the hundred nodes around a place, torch spends most of its time on overhead.
What does not hang on the place is computed once: every object of a class begins alike, and so does every place, so the
first layer is a product of how many neighbours of each kind a node has with a table of what each kind sends. It reckons
in float64 and rounds once, so that an embedding does not hang on how the processor at hand orders a sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard, cast

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.encoder.base import Encoded
from semloc_core.encoding.encoder.layers import SumLayer, as_array
from semloc_core.encoding.encoder.paper.credit import follow
from semloc_core.encoding.encoder.paper.encoder import TINY, PaperEncoder
from semloc_core.encoding.encoder.paper.gatv2 import NEGATIVE_SLOPE
from semloc_core.encoding.place_graph import Batch

Array = NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_COUNTS = 2**17
"""Entries of a layer's table of neighbours, beyond which torch's sparse sums are faster."""


@dataclass(frozen=True, eq=False)
class _Sum:
    """A sum layer in eval mode: weights as (in, out), batch norm as a factor and an offset."""

    message: Floats
    root: Floats
    bias: Floats
    scale: Floats
    shift: Floats

    @classmethod
    def of(cls, layer: SumLayer) -> _Sum:
        scale, shift = layer.norm_as_affine()
        weights = (layer.message.weight.t(), layer.root.weight.t(), layer.message.bias, scale, shift)
        return cls(*map(as_array, weights))


@dataclass(frozen=True, eq=False)
class _Near:
    """One place's ego graph: kind (N,), 0 for places and 1 + class for objects; edges by target; prefixes by hop."""

    kind: Ints
    source: Ints
    target: Ints
    nodes: tuple[int, ...]
    edges: tuple[int, ...]


class PaperQuery:
    """Embeds one place at a time, with the weights that the encoder has now.

    Args:
        encoder: in eval mode, on the CPU.

    """

    def __init__(self, encoder: PaperEncoder) -> None:
        self._hops = encoder.hops
        with torch.no_grad():
            # What each kind of node begins as: a place, then an object of each class.
            features = torch.cat([torch.zeros(1, encoder.n_classes), torch.eye(encoder.n_classes)])
            state = torch.nn.functional.elu(encoder.project(features).double())
            self._first, *self._layers = [_Sum.of(cast("SumLayer", layer)) for layer in encoder.layers]
            start = as_array(state)
            self._sent = start @ self._first.message
            self._own = start @ self._first.root + self._first.bias
            self._embed, self._embed_bias = as_array(encoder.embed.weight.t()), as_array(encoder.embed.bias)
            self._gat = gat = encoder.gat
            if gat is not None:
                self._source, self._source_bias = as_array(gat.source.weight.t()), as_array(gat.source.bias)
                self._target, self._target_bias = as_array(gat.target.weight.t()), as_array(gat.target.bias)
                self._attention, self._gat_bias = as_array(gat.spread()), as_array(gat.bias)

    @staticmethod
    def fits(encoder: object, batch: Batch) -> TypeGuard[PaperEncoder]:
        """Whether an encoder and a batch are of the kind that this is for."""
        if type(encoder) is not PaperEncoder or batch.kinds is None or batch.n_roots != 1 or encoder.training:
            return False
        nodes, hops = batch.nodes_within, encoder.hops
        if len(batch.edges_within) < hops:
            return False
        widest = max(nodes[hops - 1] * (encoder.n_classes + 1), nodes[max(0, hops - 2)] * nodes[hops - 1])
        return widest <= MOST_COUNTS

    def encode(self, batch: Batch) -> Encoded:
        """Embed, with the attention rolled out to the objects, as `PaperEncoder.encode` does.

        Args:
            batch: of one place, for which `fits` holds.

        """
        near = self._near(batch)
        z, weights, own = self._forward(near)
        embedding = torch.from_numpy(z[None].astype(np.float32))
        if weights is None:
            return Encoded(embedding, None, None)
        is_object = near.kind > 0
        graph = np.zeros(len(near.kind), dtype=np.int64)
        credit, rest = follow(is_object, graph, 1, near.nodes, near.edges, near.source, near.target, weights, own)
        return Encoded(embedding, *(torch.from_numpy(x.astype(np.float32)) for x in (credit, rest)))

    def embed(self, batch: Batch, keep: NDArray[np.bool_]) -> Array:
        """(K, D) embeddings of K variants of one place.

        Args:
            batch: of one place, for which `fits` holds.
            keep: (K, N) which nodes stay; the others are removed, as in `PaperEncoder.forward`.

        """
        near = self._near(batch)
        return np.array([self._forward(_without(near, stays))[0] for stays in keep], dtype=np.float32)

    def _near(self, batch: Batch) -> _Near:
        assert batch.kinds is not None
        edges = batch.edges_within[: self._hops]
        source, target = batch.edge_index.numpy()[:, : edges[-1]]
        return _Near(batch.kinds, source, target, batch.nodes_within, edges)

    def _forward(self, near: _Near) -> tuple[Floats, Floats | None, Floats | None]:
        """(D,) of unit length; (E, heads) attention and (1, heads) of the self-loop."""
        first, kinds = self._first, len(self._sent)
        n, count = near.nodes[self._hops - 1], near.edges[self._hops - 1]
        cell = near.target[:count] * kinds + near.kind[near.source[:count]]
        counts = np.bincount(cell, minlength=n * kinds).reshape(n, kinds).astype(np.float64)
        x: Floats = counts @ self._sent
        x += self._own[near.kind[:n]]
        x = _norm(x, first)
        for hops, layer in zip(range(self._hops - 2, -1, -1), self._layers, strict=False):
            wide, n, count = n, near.nodes[hops], near.edges[hops]
            adjacency = np.bincount(near.target[:count] * wide + near.source[:count], minlength=n * wide)
            total = adjacency.reshape(n, wide).astype(np.float64) @ x
            y: Floats = np.matmul(total, layer.message)
            y += x[:n] @ layer.root
            y += layer.bias
            x = _norm(y, layer)
        weights = own = None
        out = x[:1]
        if self._gat is not None:
            out, weights, own = self._attend(x, near.source[: near.edges[0]])
        z = (out @ self._embed)[0] + self._embed_bias
        return z / max(float(np.sqrt(np.dot(z, z))), TINY), weights, own

    def _attend(self, x: Floats, source: Ints) -> tuple[Floats, Floats, Floats | None]:
        """GATv2 towards the root: (1, heads · H), weights of the edges (E, heads) and of the self-loop (1, heads)."""
        assert self._gat is not None
        heads, loops = self._gat.heads, self._gat.self_loops
        if not len(source) and not loops:
            return self._gat_bias[None], np.zeros((0, heads)), None
        rows = np.append(source, 0) if loops else source
        sent = x.take(rows, axis=0) @ self._source
        sent += self._source_bias
        pair = sent + (x[:1] @ self._target + self._target_bias)
        logits = np.maximum(pair, NEGATIVE_SLOPE * pair) @ self._attention
        logits -= logits.max(0)
        weight = np.exp(logits, out=logits)
        weight /= weight.sum(0)
        out = (weight[:, :, None] * sent.reshape(len(rows), heads, -1)).sum(0).reshape(1, -1)
        out += self._gat_bias
        return out, weight[: len(source)], weight[len(source) :] if loops else None


def _without(near: _Near, keep: NDArray[np.bool_]) -> _Near:
    """The ego graph with some nodes' edges gone; nodes keep their rows, nothing arrives at them or leaves."""
    stays = keep[near.source] & keep[near.target]
    before = np.concatenate([[0], np.cumsum(stays)])
    edges = tuple(int(before[count]) for count in near.edges)
    return _Near(near.kind, near.source[stays], near.target[stays], near.nodes, edges)


def _norm(x: Floats, layer: _Sum) -> Floats:
    """Batch norm of tanh, in place."""
    np.tanh(x, out=x)
    x *= layer.scale
    x += layer.shift
    return x
