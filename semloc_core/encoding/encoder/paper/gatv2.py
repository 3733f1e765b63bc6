"""GATv2 (Brody, Alon, Yahav, "How Attentive are Graph Attention Networks?", ICLR 2022), trimmed to the targets wanted.

Agrees with ``torch_geometric.nn.GATv2Conv`` (concatenated heads, unshared weights) in outputs and attention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from semloc_core.encoding.encoder.layers import Linear
from semloc_core.text import short_repr

NEGATIVE_SLOPE = 0.2


@short_repr
@dataclass(frozen=True, eq=False)
class Attention:
    """Attention weights; over all that sends to one target they sum to 1 for each head.

    Args:
        edges: (E, heads) float32.
        self_loops: (n_targets, heads) float32, or None for a layer without self-loops.

    """

    edges: Tensor
    self_loops: Tensor | None


class GATv2(nn.Module):
    """GATv2 convolution: α_ij = softmax_j(aᵀ LeakyReLU(W_s x_j + W_t x_i)), y_i = ‖_heads Σ_j α_ij W_s x_j + b.

    Args:
        inputs: width of x.
        outputs: width of one head.
        heads: number of heads, concatenated.
        generator: source of the initial weights (Glorot, as PyG).
        self_loops: whether a node attends to itself too (PyG's default).

    """

    def __init__(
        self, inputs: int, outputs: int, heads: int, generator: torch.Generator, self_loops: bool = True
    ) -> None:
        super().__init__()
        self.heads, self.outputs, self.self_loops = heads, outputs, self_loops
        self.source = Linear(inputs, heads * outputs)
        self.target = Linear(inputs, heads * outputs)
        self.attention = nn.Parameter(torch.empty(heads, outputs))
        self.bias = nn.Parameter(torch.zeros(heads * outputs))
        for linear in (self.source, self.target):
            _glorot(linear.weight, generator)
            nn.init.zeros_(linear.bias)
        _glorot(self.attention, generator)

    def forward(self, x: Tensor, source: Tensor, target: Tensor, n_targets: int) -> tuple[Tensor, Attention]:
        """Compute the first ``n_targets`` rows and the attention behind them.

        Args:
            x: (n, inputs) float32.
            source: (E,) int64, rows of x; no edge may be a self-loop.
            target: (E,) int64, < n_targets.
            n_targets: how many rows (a prefix of x) are wanted.

        Returns:
            (n_targets, heads * outputs) float32 and the attention. Without self-loops a target that nothing
            sends to gets the bias alone.

        """
        sent = self.source(x)
        asked = self.target(x[:n_targets])
        messages = sent.index_select(0, source)
        logits = self._logits(messages + asked.index_select(0, target))
        own = self._logits(sent[:n_targets] + asked) if self.self_loops else None

        # softmax over each target's inputs; the greatest logit is subtracted, and is a constant to the gradient
        with torch.no_grad():
            index = target[:, None].expand(-1, self.heads)
            top = logits.new_full((n_targets, self.heads), -torch.inf) if own is None else own.clone()
            top.scatter_reduce_(0, index, logits, "amax")
        weight = torch.exp(logits - top.index_select(0, target))
        own_weight = None if own is None else torch.exp(own - top)
        start = torch.zeros_like(top) if own_weight is None else own_weight
        total = start.index_add(0, target, weight).clamp_min(torch.finfo(x.dtype).tiny)

        alpha = weight / total.index_select(0, target)
        out = x.new_zeros(n_targets, self.heads * self.outputs)
        out = out.index_add_(0, target, self._weigh(messages, alpha))
        own_alpha = None if own_weight is None else own_weight / total
        if own_alpha is not None:
            out = out + self._weigh(sent[:n_targets], own_alpha)
        return out + self.bias, Attention(alpha, own_alpha)

    def spread(self) -> Tensor:
        """(heads * outputs, heads) the attention vectors as one matrix, in place of a sum over each head."""
        found: Tensor = (torch.eye(self.heads)[:, None, :] * self.attention.detach()[:, :, None]).flatten(0, 1)
        return found

    def _logits(self, pair: Tensor) -> Tensor:
        """(E, heads * outputs) -> (E, heads)."""
        logits: Tensor = (F.leaky_relu(pair, NEGATIVE_SLOPE).view(-1, self.heads, self.outputs) * self.attention).sum(
            -1
        )
        return logits

    def _weigh(self, messages: Tensor, alpha: Tensor) -> Tensor:
        """Each head's message times its attention: (E, heads * outputs)."""
        return (messages.view(-1, self.heads, self.outputs) * alpha[:, :, None]).flatten(1)


def _glorot(weight: Tensor, generator: torch.Generator) -> None:
    bound = math.sqrt(6.0 / (weight.shape[0] + weight.shape[1]))
    nn.init.uniform_(weight, -bound, bound, generator=generator)
