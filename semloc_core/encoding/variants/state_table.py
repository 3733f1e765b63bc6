"""First states of a place's nodes under many removals, each different one once.

After the first layer a node's state hangs on nothing but how many neighbours of each kind it has left. Hundreds of
variants leave a node only a few such counts: each is computed once, into a table, and the second layer sums rows of
the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from semloc_core.text import short_repr

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_CODES = 2**20
"""Beyond these, counts are told apart by sorting those that occur, not by a table of all that could."""
EXACT = 2.0**52
"""Codes are summed in floating point; up to here each is an integer of its own."""


@short_repr
@dataclass(frozen=True, eq=False)
class StateTable:
    """States after the first layer.

    Args:
        counts: (U, kinds) float32: neighbours of each kind that are left; each row of the table once.
        own: (U,) int64, the kind of the node itself.
        index: (K, n) int64, the row of each node in each variant.

    """

    counts: Tensor
    own: Tensor
    index: Tensor


class FirstLayer:
    """Which rows of a `StateTable` variants need.

    Args:
        adjacency: (n, N) how many edges into each node whose state is wanted, from each node.
        kind: (N,) int64, 0 … kinds-1; nodes of one kind begin alike.

    """

    def __init__(self, adjacency: Tensor, kind: Tensor) -> None:
        self._adjacency: Floats = adjacency.double().numpy()
        self._kind: Ints = kind.numpy()
        self._of_kind: Floats = np.eye(int(kind.max()) + 1)[self._kind]  # (N, kinds)
        self._whole: Floats = self._adjacency @ self._of_kind

    def table(self, keep: Tensor) -> StateTable | None:
        """Counts of every node in K variants, each different one once.

        Args:
            keep: (K, N) bool.

        Returns:
            None where a node has so many neighbours that their counts can't be told apart by one number.

        """
        kept = keep.numpy()
        n, k = len(self._adjacency), len(kept)
        gone = np.flatnonzero(~kept.all(0))
        removable, present = self._adjacency[:, gone], kept[:, gone].astype(np.float64)
        varying = np.flatnonzero(removable.any(1))
        most = removable[varying] @ self._of_kind[gone]  # (v, kinds) that can go
        radix = np.cumprod(most + 1.0, axis=1)
        size = radix[:, -1]
        if size.sum() >= EXACT:
            return None
        digit = np.concatenate([np.ones((len(varying), 1)), radix[:, :-1]], axis=1)  # of a kind's count in the code
        code = present @ (removable[varying] * digit[:, self._kind[gone]]).T  # (K, v)
        start = np.cumsum(size) - size
        first, number = _distinct((code + start).astype(np.int64), int(size.sum()))
        variant, row = np.divmod(first, max(1, len(varying)))
        left = self._whole[varying] - most
        counts = left[row] + (removable[varying[row]] * present[variant]) @ self._of_kind[gone]
        index = np.empty((k, n), dtype=np.int64)
        index[:] = np.arange(n)
        index[:, varying] = n + number
        return StateTable(
            torch.from_numpy(np.concatenate([self._whole, counts]).astype(np.float32)),
            torch.from_numpy(self._kind[np.concatenate([np.arange(n), varying[row]])]),
            torch.from_numpy(index),
        )


class TableSum:
    """Of each of the first ``n`` nodes, in each variant: a row for itself, and one for each edge into it, summed.

    Args:
        source: (E,) int64.
        target: (E,) int64, ascending, < n.
        n: how many nodes.
        nodes: how many nodes there are, n': what edges may start at.

    """

    def __init__(self, source: Tensor, target: Tensor, n: int, nodes: int) -> None:
        self._n = n
        order = torch.cat([torch.arange(n), target]).sort(stable=True)  # each node, then its edges
        self._columns = torch.cat([nodes + torch.arange(n), source])[order.indices]
        self._start = torch.searchsorted(order.values, torch.arange(n))

    def of(self, rows: Tensor, index: Tensor, keep: Tensor) -> Tensor:
        """(K, n, W) sums.

        Args:
            rows: (2 U + 1, W) float32: what a node in each state sends, what it keeps for itself, and zero.
            index: (K, n') int64, the state of each node.
            keep: (K, N) bool; what a node sends that is gone counts for nothing.

        """
        k, nodes = index.shape
        sends = torch.where(keep[:, :nodes], index, len(rows) - 1)
        both = torch.cat([sends, index[:, : self._n] + len(rows) // 2], 1).index_select(1, self._columns)
        bags = (torch.arange(k)[:, None] * both.shape[1] + self._start).flatten()
        return F.embedding_bag(both.flatten(), rows, bags, mode="sum").view(k, self._n, -1)


def _distinct(codes: Ints, total: int) -> tuple[Ints, Ints]:
    """Positions (U,) of one of each code, in the order of the codes; and the codes' numbers 0 … U-1, in their shape."""
    flat = codes.ravel()
    if total > MOST_CODES:
        _, first, number = np.unique(flat, return_index=True, return_inverse=True)
        return first.astype(np.int64), number.reshape(codes.shape).astype(np.int64)
    at = np.full(total, -1, dtype=np.int64)
    at[flat] = np.arange(len(flat))
    occurs = at >= 0
    number = np.cumsum(occurs) - 1
    return at[occurs], number[codes]
