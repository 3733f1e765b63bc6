"""How likely it is to have seen what has been seen, from each place of a map: a likelihood that knows where one looked.

A similarity punishes a fragment for what has not been seen yet. Here the places that the robot knows say how far it
has looked: in ring r around the robot (soft rings by geodesic distance) it knows e_r places, and has seen q_cr objects
of class c there. A place of the map has m_cr objects and n_r places in the same ring, so that so much looking should
have shown e_r · λ_cr of them, with a rate λ_cr = detected · m_cr / (n_r + 1) + invented_c. Seen counts are taken as
Poisson (inhomogeneous Poisson process, its exposure the known places):

    log P(q | place) = Σ_cr q_cr log λ_cr − Σ_r e_r Σ_c λ_cr − shape · Σ_r max(0, e_r − slack · n_r − 1) + constant

The last term refuses places around which the map has less room than the robot has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from semloc_core.graph import Labelspace, SceneGraph
from semloc_core.text import short_repr

Floats = NDArray[np.float32]
Metres = NDArray[np.float64]

RING_CENTRES_M = np.array([0.0, 1.5, 3.0, 5.0, 8.0, 12.0, 17.0, 23.0])
RING_WIDTHS_M = np.array([0.8, 0.8, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
REACH_M = 30.0


class ObservationConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a detector does, as far as the likelihood is concerned."""

    detected: Annotated[float, Meta(gt=0.0, le=1.0, description="share of the mapped objects that are detected")] = 0.77
    invented: Annotated[
        float, Meta(gt=0.0, le=10.0, description="objects seen for each known place that the map does not have")
    ] = 0.04
    shape: Annotated[
        float, Meta(ge=0.0, le=100.0, description="log-likelihood lost for each place more than the map has room for")
    ] = 0.3
    slack: Annotated[
        float, Meta(ge=1.0, le=100.0, description="how many times more places a run may lay than the map has")
    ] = 1.3


@short_repr
@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is known around N places, ring by ring.

    Args:
        objects: (N, C, R) float32, objects by class and ring; each is shared among rings, its shares sum to 1.
        places: (N, R) float32, places by ring, in the same way.

    """

    objects: Floats
    places: Floats

    def __post_init__(self) -> None:
        n, _, r = self.objects.shape
        assert self.places.shape == (n, r), (self.places.shape, self.objects.shape)
        assert self.objects.dtype == np.float32, self.objects.dtype
        assert self.places.dtype == np.float32, self.places.dtype


def surroundings(
    graph: SceneGraph, labelspace: Labelspace, places: Sequence[str], *, distances: Sequence[Metres] | None = None
) -> Surroundings:
    """Count what is around some places of a scene graph.

    Args:
        graph: a building, or what is known of one.
        labelspace: gives objects their class; those of a class that it lacks are left out.
        places: N places of the graph.
        distances: for each of them, the distances by slot of ``graph.index`` up to `REACH_M`, where they are known.

    """
    slots = graph.index.slots
    known = sorted(key for key in graph.objects if labelspace.index(graph.objects[key].class_) >= 0)
    links = [(slots[parent], i) for i, key in enumerate(known) for parent in graph.parents[key]]
    parent, child = np.array(links, dtype=np.int64).reshape(-1, 2).T
    class_ = np.array([labelspace.index(graph.objects[key].class_) for key in known], dtype=np.int64)
    objects = np.zeros((len(places), len(labelspace), len(RING_CENTRES_M)), dtype=np.float32)
    counts = np.zeros((len(places), len(RING_CENTRES_M)), dtype=np.float32)
    taken = np.array(sorted(slots.values()), dtype=np.int64)
    for row, place in enumerate(places):
        metres = distances[row] if distances is not None else slot_distances(graph, place, REACH_M)
        around = metres[taken]
        # Slots are as nodes came; a sum must not hang on that, to its last bit.
        counts[row] = ring_shares(np.sort(around[around <= REACH_M])).sum(axis=0)
        nearest = np.full(len(known), np.inf)
        np.minimum.at(nearest, child, metres[parent])
        near = np.flatnonzero(nearest <= REACH_M)
        np.add.at(objects[row], class_[near], ring_shares(nearest[near]))
    return Surroundings(objects, counts)


def slot_distances(graph: SceneGraph, place: str, radius_m: float) -> Metres:
    """Geodesic distance (m) of every slot of ``graph.index`` from a place; more than the radius where not reached."""
    return np.array(graph.index.distances(place, radius_m), dtype=np.float64)


def ring_shares(metres: Metres) -> Floats:
    """(K, R) float32 shares of K distances (m) in the rings, Gaussian by distance from the centres; rows sum to 1."""
    # The log of a Gaussian, shifted by its row's largest: far beyond the last ring all would round to zero.
    log = -0.5 * ((metres[:, None] - RING_CENTRES_M) / RING_WIDTHS_M) ** 2
    weight = np.exp(log - log.max(axis=1, keepdims=True, initial=-np.inf))
    shares: Floats = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    return shares


class ObservationModel:
    """The likelihood of an observation at each of M places of a map.

    Args:
        mapped: what the map has around its places.
        config: what the detector does.

    """

    def __init__(self, mapped: Surroundings, config: ObservationConfig | None = None) -> None:
        config = config or ObservationConfig()
        m, c, r = mapped.objects.shape
        # Each building counts by its objects; a class that no map has can be invented too.
        near = mapped.objects.sum(axis=(0, 2), dtype=np.float64)
        frequency = (near / max(near.sum(), 1.0) + 0.1 / c) / 1.1
        rate = config.detected * mapped.objects / (mapped.places[:, None] + 1.0)
        rate += np.float32(config.invented) * frequency[None, :, None].astype(np.float32)
        self._log_rate: Floats = np.ascontiguousarray(np.log(rate).reshape(m, c * r).T, dtype=np.float32)
        self._total: Floats = np.ascontiguousarray(rate.sum(axis=1).T, dtype=np.float32)
        self._room: Floats = np.float32(config.slack) * mapped.places + np.float32(1.0)
        self._shape = np.float32(config.shape)

    @property
    def n_places(self) -> int:
        """M."""
        return int(self._total.shape[1])

    @property
    def n_rings(self) -> int:
        """R."""
        return len(self._total)

    def log_likelihood(self, seen: Surroundings) -> Floats:
        """(N, M) float32: log-likelihood, up to a constant a row, of N observations at each place of the map.

        Places with equal surroundings have equal ones: each sum is taken in the same order, which BLAS does not do.
        """
        counts = seen.objects.reshape(len(seen.objects), -1)
        result: Floats = np.einsum("nk,km->nm", counts, self._log_rate)
        result -= np.einsum("nr,rm->nm", seen.places, self._total)
        if self._shape:
            for row, places in zip(result, seen.places, strict=True):
                row -= self._shape * np.maximum(places - self._room, np.float32(0.0)).sum(axis=1)
        return result
