"""Building blocks of message passing: edges trimmed layer by layer, and the paper's sum layer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from semloc_core.encoding.place_graph import Batch
from semloc_core.errors import ModelError
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class TrimmedEdges:
    """The edges of a batch that are still there, and how long a prefix each layer needs.

    Args:
        source: (E,) int64.
        target: (E,) int64, ascending.
        within: within[h] = how many edges (a prefix) have a target at most h hops from its root.

    """

    source: Tensor
    target: Tensor
    within: tuple[int, ...]

    def reaching(self, hops: int) -> tuple[Tensor, Tensor]:
        """Sources and targets of the edges whose target is at most ``hops`` from its root."""
        count = self.within[hops]
        return self.source[:count], self.target[:count]


def trim(batch: Batch, hops: int, keep: Tensor | None = None) -> TrimmedEdges:
    """Edges that an encoder of ``hops`` layers reads.

    Args:
        batch: B places with at least ``hops`` hops around each.
        hops: number of layers.
        keep: (N,) bool or None; an edge goes where its source or its target is removed. Order is kept, so that
            a prefix stays a prefix.

    Raises:
        ModelError: the batch reaches fewer hops than the encoder has layers.

    """
    if len(batch.edges_within) < hops:
        raise ModelError(f"expected a batch of at least {hops} hops (got {len(batch.edges_within)})")
    within = batch.edges_within[:hops]
    source, target = batch.edge_index[0, : within[-1]], batch.edge_index[1, : within[-1]]
    if bool((target[1:] < target[:-1]).any()):  # nodes are sorted by hop, so a prefix by hop stays one
        target, order = target.sort(stable=True)
        source = source.index_select(0, order)
    if keep is None:
        return TrimmedEdges(source, target, within)
    stays = keep.index_select(0, source) & keep.index_select(0, target)
    counts = torch.cat([stays.new_zeros(1, dtype=torch.int64), stays.cumsum(0)])
    return TrimmedEdges(source[stays], target[stays], tuple(counts[list(within)].tolist()))


def sum_by_target(x: Tensor, source: Tensor, target: Tensor, n_targets: int) -> Tensor:
    """Σ over the edges into each target of the source's row of x.

    Gather and sum in one kernel, never holding a row for each edge: up to ten times as fast on a CPU as
    ``index_select`` and ``index_add``, with the same order of summation.

    Args:
        x: (n, D) float32.
        source: (E,) int64, rows of x.
        target: (E,) int64, ascending.
        n_targets: how many rows are wanted.

    Returns:
        (n_targets, D) float32.

    """
    starts = torch.searchsorted(target, torch.arange(n_targets, device=target.device))
    return F.embedding_bag(source, x, starts, mode="sum")


class Linear(nn.Linear):
    """`torch.nn.Linear` (same distribution of initial weights) that draws from an explicit generator."""

    def reset_parameters(self, generator: torch.Generator | None = None) -> None:
        """Kaiming-uniform with a = √5, as torch's; without a generator the weights stay unset."""
        if generator is None:  # called by nn.Linear's constructor
            return
        bound = 1.0 / math.sqrt(self.in_features)
        nn.init.uniform_(self.weight, -bound, bound, generator=generator)
        if self.bias is not None:
            nn.init.uniform_(self.bias, -bound, bound, generator=generator)


class SumLayer(nn.Module):
    """One message-passing layer: y_i = BN(tanh(W_root x_i + W_msg Σ_j x_j + b)), the sum over i's in-neighbours.

    The paper (Section IV-B.1) says: neighbour information aggregated with a sum, then tanh and batch
    normalisation. It is silent on the node's own state; here that has a weight of its own, as in GraphConv
    (Morris et al. 2019, ``torch_geometric.nn.GraphConv``): with a weight shared between the two, a sum could
    not tell a place from its neighbours. The order tanh, then normalisation is the paper's wording.

    Args:
        inputs: width of x.
        outputs: width of y.
        generator: source of the initial weights.

    """

    def __init__(self, inputs: int, outputs: int, generator: torch.Generator) -> None:
        super().__init__()
        self.message = Linear(inputs, outputs)
        self.root = Linear(inputs, outputs, bias=False)
        self.norm = nn.BatchNorm1d(outputs)
        self.message.reset_parameters(generator)
        self.root.reset_parameters(generator)

    def forward(self, x: Tensor, source: Tensor, target: Tensor, n_targets: int) -> Tensor:
        """Compute the first ``n_targets`` rows.

        Args:
            x: (n, inputs) float32, every node that a source or a target names.
            source: (E,) int64, rows of x.
            target: (E,) int64, ascending, < n_targets.
            n_targets: how many rows (a prefix of x) are wanted.

        Returns:
            (n_targets, outputs) float32. In training mode batch norm takes its statistics from these rows.

        """
        y: Tensor = torch.addmm(
            self.message(sum_by_target(x, source, target, n_targets)), x[:n_targets], self.root.weight.t()
        )
        normed: Tensor = self.norm(torch.tanh(y))
        return normed

    def norm_as_affine(self) -> tuple[Tensor, Tensor]:
        """What batch norm does in eval mode, as a factor and an offset, (outputs,) each."""
        norm = self.norm
        mean, variance = cast("Tensor", norm.running_mean), cast("Tensor", norm.running_var)
        scale = norm.weight / torch.sqrt(variance + norm.eps)
        return scale, norm.bias - mean * scale


def as_array(tensor: Tensor) -> NDArray[np.float64]:
    """Weights for numpy: float64, C-contiguous, without a gradient."""
    array: NDArray[np.float64] = np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float64)
    return array
