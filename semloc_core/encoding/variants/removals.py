"""The paper's encoder on many variants of one place that differ in which nodes are gone.

The same function as `semloc_core.encoding.variants.copies.PaperCopies`, in a fraction of the time: first states come
from a `StateTable`, and only the root and its neighbours are computed for each variant.
"""

from __future__ import annotations

import torch
from torch import Tensor

from semloc_core.encoding.encoder.layers import trim
from semloc_core.encoding.encoder.paper.encoder import PaperEncoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.variants.copies import PaperCopies, deeper, unit
from semloc_core.encoding.variants.state_table import FirstLayer, StateTable, TableSum

VARIANTS_AT_ONCE = 2**12
"""In one table."""
ROWS_AT_ONCE = 2**11
"""States near the root: what fits into a processor's cache."""


class PaperRemovals:
    """Embeds variants of one place; numbers as from the encoder but for rounding.

    Args:
        encoder: in eval mode; its weights as they are now.
        batch: one place, N nodes.
        copies: the same two in the other layout.

    """

    def __init__(self, encoder: PaperEncoder, batch: Batch, copies: PaperCopies) -> None:
        self._copies, self._layers = copies, copies.layers
        self._state, kind = copies.kinds()
        self._first = FirstLayer(self._layers[0].adjacency, kind[: self._layers[0].adjacency.shape[1]])
        self._sum = None
        if len(self._layers) > 1:
            edges = trim(batch, encoder.hops).reaching(encoder.hops - 2)
            self._sum = TableSum(*edges, *self._layers[1].adjacency.shape)

    def embed(self, keep: Tensor) -> Tensor:
        """(K, N) bool, what is kept -> (K, D)."""
        with torch.no_grad():
            return torch.cat([part for some in torch.split(keep, VARIANTS_AT_ONCE) for part in self._some(some)])

    def table(self, keep: Tensor) -> StateTable | None:
        """First states that variants (K, N) need; None where they can't be told apart by one number."""
        return self._first.table(keep)

    def _some(self, keep: Tensor) -> list[Tensor]:
        near = len(self._layers[min(1, len(self._layers) - 1)].adjacency)
        at_once = max(1, ROWS_AT_ONCE // near)
        table = self.table(keep)
        if table is None:
            return [self._copies.embed(None, few) for few in torch.split(keep, at_once)]
        return self._by_table(table, keep, at_once)

    def _by_table(self, table: StateTable, keep: Tensor, at_once: int) -> list[Tensor]:
        first = self._layers[0]
        own = torch.addmm(first.bias, self._state, first.root.t())
        tanh = torch.addmm(own[table.own], table.counts, self._state @ first.message.t()).tanh_()
        states = torch.addcmul(first.shift, tanh, first.scale)
        starts = range(0, len(keep), at_once)
        if self._sum is None:
            cut = [(table.index[i : i + at_once], keep[i : i + at_once]) for i in starts]
            return [unit(self._copies.last(states[index].transpose(0, 1), kept)[1]) for index, kept in cut]
        second = self._layers[1]
        own = torch.addmm(second.bias, states, second.root.t())
        rows = torch.cat([states @ second.message.t(), own, own.new_zeros(1, own.shape[1])])
        parts = []
        for i in starts:
            kept = keep[i : i + at_once]
            tanh = self._sum.of(rows, table.index[i : i + at_once], kept).tanh_()
            x = torch.addcmul(second.shift, tanh, second.scale).transpose(0, 1)
            for layer in self._layers[2:]:
                x = torch.addcmul(layer.shift, deeper(layer, x, kept), layer.scale)
            parts.append(unit(self._copies.last(x, kept)[1]))
        return parts
