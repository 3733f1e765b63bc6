"""How far class labels alone can tell places apart: colour refinement on a map's own graph.

A message-passing encoder of T layers that reads nothing but class labels gives two places the same embedding whenever
T rounds of colour refinement (1-dimensional Weisfeiler–Leman) give them the same colour (Xu et al., "How Powerful are
Graph Neural Networks?", ICLR 2019). So the colours of a map bound what any training can reach on it: the query is a
place of the map as it was mapped, nothing perturbed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import (
    BagOfWordsEncoder,
    Batch,
    Encoder,
    HistogramEncoder,
    PaperEncoder,
    TfidfEncoder,
    extract_all,
)
from semloc_core.evaluate.twins import metres_between
from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.metrics import Row
from semloc_core.text import short_repr

LABELS_ONLY: tuple[type[Encoder], ...] = (PaperEncoder, BagOfWordsEncoder, HistogramEncoder, TfidfEncoder)
"""Encoders that read class labels and edges; for those that read distances too, colours bound nothing."""


@short_repr
@dataclass(frozen=True, eq=False)
class Aliasing:
    """What colours say of the places of a map.

    Args:
        colours: (P,) int64, 0 … K-1 by first place.
        alone: places whose colour no other has.
        spread_m: (P,) metres to the farthest place of the same colour; 0 where alone, infinite across buildings.
        ceiling: the best success@1: for each colour the one answer that is right for most of its places.
        by_chance: success@1 where each answer is drawn from its colour's places.

    """

    NEAR_M: ClassVar[float] = MATCH_RADIUS_M
    colours: Ints
    alone: int
    spread_m: Floats
    ceiling: float
    by_chance: float

    def row(self, method: str, scope: str) -> Row:
        """The figures under the names that are printed."""
        aliased = self.spread_m > 0
        finite = self.spread_m[aliased & np.isfinite(self.spread_m)]
        return {
            "method": method,
            "scope": scope,
            "places": len(self.colours),
            "colours": int(self.colours.max(initial=-1)) + 1,
            "alone": self.alone,
            "far_aliases": int((self.spread_m > self.NEAR_M).sum()),
            "spread_p50_m": float(np.median(finite)) if len(finite) else 0.0,
            "spread_max_m": float(self.spread_m.max(initial=0.0)),
            "success@1_ceiling": self.ceiling,
            "success@1_by_chance": self.by_chance,
        }


def reads_labels_only(encoder: Encoder) -> bool:
    """Whether colours bound what an encoder can tell apart."""
    return isinstance(encoder, LABELS_ONLY)


def map_aliasing(encoder: Encoder, buildings: Sequence[GraphArrays], n_classes: int) -> Aliasing | None:
    """Colours of all places of all buildings together, at the encoder's depth; None: it reads more than labels.

    Args:
        encoder: of the map.
        buildings: in any order; each has a frame of its own, so places of two are infinitely far apart.
        n_classes: C of the labelspace that the arrays were made with.

    """
    if not reads_labels_only(encoder):
        return None
    batches = [extract_all(arrays, n_classes, encoder.extraction) for arrays in buildings]
    colours = colour_refinement(batches, encoder.extraction.hops)
    places = [found[: batch.n_roots] for found, batch in zip(colours, batches, strict=True)]
    positions = [arrays.place_positions for arrays in buildings]
    return aliasing(np.concatenate([*places, np.zeros(0, dtype=np.int64)]), positions)


def colour_refinement(batches: Sequence[Batch], rounds: int) -> list[Ints]:
    """(N,) colours of the nodes of each graph: nodes of one colour, in whichever graph, can't be told apart.

    The first colour is the class; then in each round a node's colour becomes its own with the multiset of those that
    send to it. Equal colours after T rounds mean equal states after T layers of message passing. Nodes that are not in
    reach of a place within ``rounds`` have no meaning: their own neighbours may not be in the batch.

    Args:
        batches: graphs, or stars, that share classes.
        rounds: T.

    """
    sizes = [batch.n_nodes for batch in batches]
    start = np.cumsum([0, *sizes])
    edges = [batch.edge_index.numpy() + first for batch, first in zip(batches, start, strict=False)]
    source, target = np.concatenate([np.zeros((2, 0), dtype=np.int64), *edges], axis=1)
    features = [np.concatenate([b.features.numpy(), b.is_object.numpy()[:, None]], axis=1) for b in batches]
    if not batches:
        return []
    colour = _numbered(np.concatenate(features))
    first = np.searchsorted(np.sort(target), np.arange(start[-1] + 1))
    for _ in range(rounds):
        order = np.lexsort((colour[source], target))  # neighbours of each node, sorted by colour: its multiset
        sent = colour[source][order]
        keys = [(int(colour[i]), sent[first[i] : first[i + 1]].tobytes()) for i in range(start[-1])]
        number: dict[tuple[int, bytes], int] = {}
        colour = np.array([number.setdefault(key, len(number)) for key in keys], dtype=np.int64)
    return [colour[a:b] for a, b in pairwise(start.tolist())]


def aliasing(colours: Ints, positions: Sequence[Floats], near_m: float = MATCH_RADIUS_M) -> Aliasing:
    """What colours of places mean for localisation.

    Args:
        colours: (P,) of all places, building after building.
        positions: of each building (P_b, 3), metres.
        near_m: an answer within this distance is right.

    """
    colours = _numbered(colours[:, None])
    building = np.repeat(np.arange(len(positions)), [len(p) for p in positions])
    at = np.concatenate([np.zeros((0, 3)), *positions])
    spread, best, chance = np.zeros(len(colours)), 0.0, 0.0
    order = np.argsort(colours, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(colours[order])) + 1) if len(order) else []
    for members in groups:
        apart = metres_between(at[members], at[members])
        apart[building[members][:, None] != building[members]] = np.inf
        spread[members] = apart.max(1)
        right = (apart <= near_m).sum(0)
        best += float(right.max())
        chance += float(right.mean())
    total = max(1, len(colours))
    alone = sum(1 for members in groups if len(members) == 1)
    return Aliasing(colours, alone, spread, best / total, chance / total)


def _numbered(rows: NDArray[np.generic]) -> Ints:
    """(n,) equal numbers for equal rows, counted up in order of first appearance."""
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    found: Ints = rank[number.reshape(-1)]
    return found
