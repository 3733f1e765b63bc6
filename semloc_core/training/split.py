"""Which places train, which validate and which test; and which pairs of places are one answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import TrainingError
from semloc_core.graph import Floats, GraphArrays
from semloc_core.text import short_repr

Bools = NDArray[np.bool_]
Part = Literal["train", "validation", "test"]
PARTS: tuple[Part, ...] = ("train", "validation", "test")
SHARES = (0.7, 0.2, 0.1)
"""Train, validation, test (paper, section IV-B2)."""


@short_repr
@dataclass(frozen=True, eq=False)
class Split:
    """The partition of one building's places.

    Args:
        part: (P,) int8, index into `PARTS`.
        positions: (P, 3) float64, metres: where the split places are, so that places sampled anew get a part too.

    """

    part: NDArray[np.int8]
    positions: Floats

    def mask(self, part: Part) -> Bools:
        """(P,) which places are in a part."""
        chosen: Bools = self.part == PARTS.index(part)
        return chosen

    def parts_of(self, graph: GraphArrays) -> NDArray[np.int8]:
        """(P',) the part of each place of a variant of the building: that of the nearest split place.

        Places that the variant shares with the building are their own nearest, so they keep their part.
        """
        from scipy.spatial import cKDTree

        if graph.n_places == 0:
            return np.zeros(0, dtype=np.int8)
        nearest = cKDTree(self.positions).query(graph.place_positions)[1]
        parts: NDArray[np.int8] = self.part[nearest]
        return parts


def split_places(graph: GraphArrays, seed: int) -> Split:
    """Partition a building's places at random, 70/20/10 (paper, section IV-B2).

    Args:
        graph: the building; P places.
        seed: the same seed gives the same partition.

    Raises:
        TrainingError: fewer than two places.

    """
    n = graph.n_places
    if n < 2:
        raise TrainingError(f"expected a graph of at least 2 places to split (got {n} in {graph.name or 'the graph'})")
    order = np.random.default_rng([seed, n]).permutation(n)
    first = max(1, round(SHARES[0] * n))
    second = max(first, round((SHARES[0] + SHARES[1]) * n))
    part = np.empty(n, dtype=np.int8)
    part[order[:first]], part[order[first:second]], part[order[second:]] = 0, 1, 2
    return Split(part=part, positions=graph.place_positions)


def positive_pairs(query: Floats, reference: Floats, radius_m: float) -> Bools:
    """Which pairs of places are one answer: those at most ``radius_m`` apart.

    The distance is three-dimensional: the paper uses (x, y), where its office has one floor; in a building
    with two, a place above another is another place.

    Args:
        query: (B, 3) metres.
        reference: (M, 3) metres, same frame.
        radius_m: the matching radius (paper: 4 m).

    Returns:
        (B, M) bool.

    """
    from scipy.spatial.distance import cdist

    near: Bools = cdist(query, reference) <= radius_m
    return near
