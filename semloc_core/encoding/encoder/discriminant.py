"""Directions that tell places apart: Fisher's discriminant of pairs of views of the same place."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from semloc_core.encoding.place_graph import Batch
from semloc_core.text import short_repr

SHRINKAGE = 3.0
"""Isotropic part of the noise, in units of its mean variance: holds back directions that only seem quiet."""


@short_repr
@dataclass(frozen=True, eq=False)
class Pairs:
    """Two views of one building.

    Args:
        queries: B places as a later run saw them.
        places: M places as mapped.
        nearest: (B,) int64, the mapped place that is the same, -1 for none.
        weight: how much these pairs count.

    """

    queries: Batch
    places: Batch
    nearest: Tensor
    weight: float = 1.0


class Discriminant:
    """Sums up how descriptors differ between views of a place (noise) and between places (signal)."""

    def __init__(self) -> None:
        self._noise: Tensor | None = None
        self._signal: Tensor | None = None
        self._mean: Tensor | None = None
        self._pairs = 0.0
        self._places = 0

    def add(self, queries: Tensor, places: Tensor, nearest: Tensor, weight: float = 1.0) -> None:
        """Take in descriptors of queries (B, F) and mapped places (M, F); arguments else as of `Pairs`."""
        queries, places = queries.double(), places.double()
        found = nearest >= 0
        change = queries[found] - places[nearest[found]]
        noise, signal, mean = weight * change.T @ change, places.T @ places, places.sum(0)
        if self._noise is None or self._signal is None or self._mean is None:
            self._noise, self._signal, self._mean = noise, signal, mean
        else:
            self._noise, self._signal, self._mean = (
                self._noise + noise,
                self._signal + signal,
                self._mean + mean,
            )
        self._pairs += weight * float(found.sum())
        self._places += len(places)

    def directions(self, n: int) -> tuple[Tensor, Tensor]:
        """The n directions of the greatest ratio of signal to noise, each with noise of unit variance.

        Solves S v = λ (W + ρ tr(W)/F · I) v with S the covariance of places, W that of the change between views and
        ρ `SHRINKAGE` (Fisher 1936; shrinkage after Friedman, "Regularized Discriminant Analysis", 1989).

        Returns:
            (k, F) float32 directions, k = min(n, F), by falling λ, and (k,) float32, minus the places' mean along
            them. The sign of each is such that its largest entry is positive.

        """
        assert self._noise is not None
        assert self._signal is not None
        assert self._mean is not None
        mean = self._mean / max(self._places, 1)
        signal = self._signal / max(self._places, 1) - torch.outer(mean, mean)
        noise = self._noise / max(self._pairs, 1e-9)
        size = len(noise)
        level = SHRINKAGE * noise.diagonal().mean().clamp_min(1e-9)
        half = torch.linalg.cholesky(noise + level * torch.eye(size, dtype=noise.dtype))
        white = torch.linalg.solve_triangular(half, signal, upper=False)
        white = torch.linalg.solve_triangular(half, white.T, upper=False)
        _, vectors = torch.linalg.eigh((white + white.T) / 2)
        best = vectors.flip(1)[:, : min(n, size)]
        weight = torch.linalg.solve_triangular(half.T, best, upper=True).T
        sign = torch.sign(weight.gather(1, weight.abs().argmax(1, keepdim=True)))
        weight = weight * sign
        return weight.float(), -(weight @ mean).float()
