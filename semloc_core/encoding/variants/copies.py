"""The paper's encoder on many variants of one place at once, in the layout (nodes, variants, width).

All variants share one graph, so a sum over neighbours is one matrix product for all of them, and nodes that begin alike
(all places; all objects of a class along one path) are computed once up to the first sum. Gradients are written out: on
a graph of tens of nodes automatic differentiation would spend its time on bookkeeping. The same function as
`semloc_core.encoding.encoder.PaperEncoder`, which stays the one that says what it is; a test holds the two together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard, cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from semloc_core.encoding.encoder.layers import SumLayer, trim
from semloc_core.encoding.encoder.paper.encoder import TINY, PaperEncoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.variants.root_attention import Attended, RootAttention
from semloc_core.text import short_repr

MOST_NODES = 600
"""Beyond these the dense adjacency matrix costs more than it saves."""


@short_repr
@dataclass(frozen=True, eq=False)
class CopiedLayer:
    """A sum layer, its batch norm as a factor and an offset."""

    adjacency: Tensor  # (n_out, n_in): how many edges
    message: Tensor  # (H, H)
    root: Tensor  # (H, H)
    bias: Tensor  # (H,)
    scale: Tensor  # (H,)
    shift: Tensor  # (H,)

    @classmethod
    def of(cls, layer: SumLayer, adjacency: Tensor) -> CopiedLayer:
        """A layer in eval mode, on a graph."""
        scale, shift = layer.norm_as_affine()
        return cls(adjacency, layer.message.weight, layer.root.weight, layer.message.bias, scale, shift)


class PaperCopies:
    """Embeds variants of one place; numbers as from the encoder but for rounding.

    Args:
        encoder: in eval mode; its weights as they are now.
        batch: one place, N nodes.

    """

    def __init__(self, encoder: PaperEncoder, batch: Batch) -> None:
        self.encoder = encoder
        self._features = batch.features
        self._project, self._embed = encoder.project, encoder.embed
        edges = trim(batch, encoder.hops)
        nodes = batch.nodes_within
        self.layers = []
        for depth, layer in enumerate(encoder.layers, start=1):
            rows, columns = nodes[encoder.hops - depth], nodes[encoder.hops - depth + 1]
            source, target = edges.reaching(encoder.hops - depth)
            adjacency = torch.zeros(rows, columns)
            adjacency.index_put_((target, source), torch.ones(len(source)), accumulate=True)
            self.layers.append(CopiedLayer.of(cast("SumLayer", layer), adjacency))
        self._gat = None if encoder.gat is None else RootAttention(encoder.gat, edges.reaching(0)[0])

    @staticmethod
    def fits(encoder: object, batch: Batch) -> TypeGuard[PaperEncoder]:
        """Whether an encoder and a place are of the kind that this is for."""
        return type(encoder) is PaperEncoder and batch.n_nodes <= MOST_NODES and batch.features.device.type == "cpu"

    def embed(self, features: Tensor | None, keep: Tensor | None) -> Tensor:
        """(K, D) of K variants; arguments as of `semloc_core.explain.similarity.Similarity`."""
        with torch.no_grad():
            return unit(self._forward(features, keep)[-1])

    def gradient(self, features: Tensor, target: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Scalar product with a target, and its gradient by the features of some nodes.

        Args:
            features: (K, N, C) float32.
            target: (D,) float32.
            rows: (R,) int64, which nodes.

        Returns:
            (K,) and (K, R, C).

        """
        with torch.no_grad():
            first, states, attended, y = self._forward(features, None)
            length = torch.linalg.vector_norm(y, dim=1, keepdim=True).clamp_min(TINY)
            z = y / length
            value = z @ target
            g = ((target - value[:, None] * z) / length) @ self._embed.weight  # (K, heads · H)
            width = states[-1].shape[2]
            g = self._gat.backward(g, attended, states[-1].shape) if self._gat is not None and attended else g[None]
            for layer, tanh in zip(reversed(self.layers[1:]), reversed(states[1:]), strict=True):
                g = _through(g, layer, tanh)
                back = layer.adjacency.t() @ (g.view(-1, width) @ layer.message).view(len(g), -1)
                back = back.view(-1, *g.shape[1:])
                back[: len(g)] += (g.view(-1, width) @ layer.root).view_as(g)
                g = back
            layer = self.layers[0]
            g = _through(g, layer, states[0])
            at_rows = layer.adjacency[:, rows].t() @ g.view(len(g), -1)
            at_rows = (at_rows.view(-1, width) @ layer.message).view(len(rows), -1, width)
            own = rows < len(g)
            at_rows[own] += (g[rows[own]].view(-1, width) @ layer.root).view(-1, *g.shape[1:])
            at_rows *= (first.state.clamp(max=0.0) + 1.0)[first.kind[rows]]  # ELU's derivative
            return value, (at_rows.view(-1, width) @ self._project.weight).view(len(rows), len(z), -1).transpose(0, 1)

    def _forward(
        self, features: Tensor | None, keep: Tensor | None
    ) -> tuple[_First, list[Tensor], Attended | None, Tensor]:
        """Kinds of first states; tanh of each layer (n, K, H); what the attention computed; (K, D) before the norm."""
        first = self._first(features)
        tanh = self._first_layer(first, keep)
        states = [tanh]
        x = torch.addcmul(self.layers[0].shift, tanh, self.layers[0].scale)
        for layer in self.layers[1:]:
            tanh = deeper(layer, x, keep)
            states.append(tanh)
            x = torch.addcmul(layer.shift, tanh, layer.scale)
        attended, y = self.last(x, keep)
        return first, states, attended, y

    def last(self, x: Tensor, keep: Tensor | None) -> tuple[Attended | None, Tensor]:
        """States near the root (n, K, H) -> what the attention computed, and (K, D) before the norm."""
        attended = None
        out = x[0]
        if self._gat is not None:
            attended = self._gat.forward(x, keep)
            out = attended.out
        return attended, torch.addmm(self._embed.bias, out, self._embed.weight.t())

    def kinds(self) -> tuple[Tensor, Tensor]:
        """First states (kinds, H) of the place as it is, and (N,) which of them each node has."""
        first = self._first(self._features[None])
        return first.state[:, 0], first.kind

    def _first(self, features: Tensor | None) -> _First:
        """Project and ELU, once for all nodes that are alike in every variant."""
        if features is None:
            state = F.elu(self._project(self._features))
            return _First(torch.arange(len(state)), state[:, None])
        rows = features.transpose(0, 1).contiguous().flatten(1).numpy()  # (N, K · C)
        packed = rows.view(f"V{rows.shape[1] * rows.itemsize}")[:, 0]
        _, pick, kind = np.unique(packed, return_index=True, return_inverse=True)
        alike = features.transpose(0, 1)[torch.from_numpy(pick)]
        return _First(torch.from_numpy(kind.reshape(-1)), F.elu(self._project(alike)))

    def _first_layer(self, first: _First, keep: Tensor | None) -> Tensor:
        """(n, K, H), tanh of the first layer."""
        layer = self.layers[0]
        n, width = len(layer.adjacency), first.state.shape[2]
        message = first.state @ layer.message.t()  # (kinds, K or 1, H)
        own = (first.state @ layer.root.t()).add_(layer.bias)
        if keep is None:
            count = layer.adjacency.new_zeros(n, len(first.state)).index_add_(1, first.kind, layer.adjacency)
            pre = (count @ message.flatten(1)).view(n, -1, width)
        else:
            # What is never removed is summed once; what is, under each variant's mask.
            sent = message[first.kind]
            gone = ~keep.all(0)
            stays = layer.adjacency[:, ~gone] @ sent[~gone].flatten(1)
            masked = sent[gone] * keep.t()[gone][:, :, None]
            pre = (layer.adjacency[:, gone] @ masked.flatten(1)).view(n, -1, width)
            pre += stays.view(n, -1, width)
        pre += own[first.kind[:n]]
        return pre.tanh_()


@dataclass(frozen=True, eq=False)
class _First:
    """Of each node its kind (N,), of each kind its state (kinds, K, H); K is 1 where features do not vary."""

    kind: Tensor
    state: Tensor


def deeper(layer: CopiedLayer, x: Tensor, keep: Tensor | None) -> Tensor:
    """States (n', K, H) -> tanh of the next layer (n, K, H)."""
    n, k, width = len(layer.adjacency), *x.shape[1:]
    from_ = x if keep is None else x * keep.t()[: len(x), :, None]
    total = (layer.adjacency @ from_.reshape(len(x), -1)).view(-1, width)
    pre = torch.addmm(layer.bias, total, layer.message.t()).addmm_(x[:n].reshape(-1, width), layer.root.t())
    return pre.tanh_().view(n, k, width)


def unit(y: Tensor) -> Tensor:
    """(K, D) scaled to unit length; zero stays zero."""
    length: Tensor = torch.linalg.vector_norm(y, dim=1, keepdim=True).clamp_min(TINY)
    return y / length


def _through(g: Tensor, layer: CopiedLayer, tanh: Tensor) -> Tensor:
    """Gradient by a layer's output -> by the argument of its tanh."""
    return g.mul(layer.scale).mul_(torch.addcmul(torch.ones(()), tanh, tanh, value=-1.0))
