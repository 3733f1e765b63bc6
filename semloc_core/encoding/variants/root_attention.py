"""GATv2 towards one place under many variants, with its gradient written out: layout (nodes, variants, width)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from semloc_core.encoding.encoder.paper.gatv2 import NEGATIVE_SLOPE, GATv2
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class Attended:
    """What the attention's gradient needs: (R, K, heads · H) sent and its argument, (R, K, heads) weights."""

    sent: Tensor
    pair: Tensor
    alpha: Tensor
    out: Tensor  # (K, heads · H)


class RootAttention:
    """GATv2 towards the root alone.

    Args:
        gat: the layer.
        source: (E,) int64, which nodes send to the root.

    """

    def __init__(self, gat: GATv2, source: Tensor) -> None:
        self.gat = gat
        self.rows = torch.cat([source, source.new_zeros(1)]) if gat.self_loops else source
        # Most often every near node sends to the root once: then nothing needs to be gathered, a softmax has no order.
        self._all = len(self.rows)
        self._gathers = not torch.equal(self.rows.sort().values, torch.arange(len(self.rows)))
        self.attention = gat.spread()

    def forward(self, x: Tensor, keep: Tensor | None) -> Attended:
        """(n, K, H) states and (K, N) bool, what is kept -> the root's new state, and how it came about."""
        heads, k, width = self.gat.heads, x.shape[1], x.shape[2]
        senders = x[self.rows] if self._gathers else x[: self._all]
        mask = None if keep is None else keep.t()[self.rows if self._gathers else slice(self._all)]
        sent = self.gat.source(senders.reshape(-1, width)).view(-1, k, heads * self.gat.outputs)
        pair = sent + self.gat.target(x[0])
        logits = (F.leaky_relu(pair, NEGATIVE_SLOPE).view(-1, pair.shape[2]) @ self.attention).view(-1, k, heads)
        if mask is not None:
            logits.masked_fill_(~mask[:, :, None], -torch.inf)
        if not len(self.rows):
            return Attended(sent, pair, logits, self.gat.bias.expand(k, -1))
        weight = torch.exp(logits - logits.amax(0).clamp_min(torch.finfo(x.dtype).min))
        alpha = weight / weight.sum(0).clamp_min(torch.finfo(x.dtype).tiny)
        out = (alpha[..., None] * sent.view(-1, k, heads, self.gat.outputs)).sum(0).flatten(1)
        return Attended(sent, pair, alpha, out + self.gat.bias)

    def backward(self, g: Tensor, of: Attended, shape: torch.Size) -> Tensor:
        """(K, heads · H), the gradient by the output -> (n, K, H), by the states."""
        by_head = g.view(-1, self.gat.heads, self.gat.outputs)  # (K, heads, H)
        g_alpha = (of.sent.view(-1, *by_head.shape) * by_head).sum(3)
        g_logits = of.alpha * (g_alpha - (of.alpha * g_alpha).sum(0))
        g_pair: Tensor = (g_logits.flatten(0, 1) @ self.attention.t()).view_as(of.pair)
        g_pair = torch.ops.aten.leaky_relu_backward(g_pair, of.pair, NEGATIVE_SLOPE, False)
        g_asked = g_pair.sum(0)
        g_sent = g_pair.add_((of.alpha[..., None] * by_head).flatten(2))
        back = (g_sent.view(-1, g_sent.shape[2]) @ self.gat.source.weight).view(-1, *shape[1:])
        if self._gathers or self._all < shape[0]:
            rows = self.rows if self._gathers else torch.arange(self._all)
            found: Tensor = back.new_zeros(shape).index_add_(0, rows, back)
        else:
            found = back
        found[0] += g_asked @ self.gat.target.weight
        return found
