"""One place's surroundings out of a whole building's batch, for explaining every place of a map in turn."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.place_graph import Batch, extract_all
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.graph import GraphArrays, ranges
from semloc_core.text import short_repr

Ints = NDArray[np.int64]


@short_repr
@dataclass(frozen=True, eq=False)
class PlaceBatches:
    """The batch of each place of a building, alone: the same embedding as from the building as a whole.

    Args:
        arrays: the building.
        n_classes: C of the labelspace that ``arrays`` was made with.
        extraction: what the encoder reads.

    """

    arrays: GraphArrays
    n_classes: int
    extraction: Extraction

    def of(self, place: int) -> Batch:
        """What the encoder reads of one place."""
        if self.extraction.kind == "reach":
            return extract_all(self.arrays, self.n_classes, self.extraction, np.array([place], dtype=np.int64))
        return _cut(self._whole, self._starts, place, self.extraction.hops)

    @cached_property
    def _whole(self) -> Batch:
        return extract_all(self.arrays, self.n_classes, self.extraction)

    @cached_property
    def _starts(self) -> Ints:
        """(N + 1,) where the edges into each node begin; edges are sorted by target."""
        return np.searchsorted(self._whole.edge_index[1].numpy(), np.arange(self._whole.n_nodes + 1))


def _cut(whole: Batch, starts: Ints, root: int, hops: int) -> Batch:
    """The nodes at most ``hops`` from ``root`` and the edges into those at most ``hops - 1`` from it."""
    sources = whole.edge_index[0].numpy()
    row = np.full(whole.n_nodes, -1, dtype=np.int64)
    row[root] = 0
    level = np.array([root], dtype=np.int64)
    levels, edges = [level], []
    for _ in range(hops):
        into = ranges(starts[level], starts[level + 1] - starts[level])
        edges.append(into)
        found = np.unique(sources[into])
        level = found[row[found] < 0]
        row[level] = len(np.concatenate(levels)) + np.arange(len(level))
        levels.append(level)
    nodes = np.concatenate(levels)
    picked = np.concatenate([*edges, np.zeros(0, dtype=np.int64)])
    chosen, into_nodes = torch.from_numpy(nodes), torch.from_numpy(picked)
    return Batch(
        features=whole.features[chosen],
        edge_index=torch.from_numpy(row)[whole.edge_index[:, into_nodes]],
        edge_length=whole.edge_length[into_nodes],
        is_object=whole.is_object[chosen],
        graph=torch.zeros(len(nodes), dtype=torch.int64),
        n_roots=1,
        nodes_within=tuple(np.cumsum([len(level) for level in levels]).tolist()),
        edges_within=tuple(np.cumsum([len(into) for into in edges]).tolist()),
        node_ids=tuple(whole.node_ids[i] for i in nodes.tolist()),
    )
