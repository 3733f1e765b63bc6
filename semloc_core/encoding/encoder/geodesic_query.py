"""Geodesic attention on one place, in numpy: what a robot asks at every update, and what its explanations ask.

The same function as `semloc_core.encoding.encoder.geodesic_attention.GeodesicAttentionEncoder`, which stays the one
that says what it is; a test holds the two together. It reckons in float64 and rounds once, so that an embedding does
not hang on how the processor at hand orders a sum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.encoder.base import Encoded
from semloc_core.encoding.encoder.geodesic_attention import TINY, GeodesicAttentionEncoder
from semloc_core.encoding.encoder.layers import as_array
from semloc_core.encoding.place_graph import Batch

Array = NDArray[np.float32]
Floats = NDArray[np.float64]

VALUES_AT_ONCE = 2**20
"""Features of variants held at a time: 8 MiB."""


@dataclass(frozen=True, eq=False)
class _Star:
    """One place: rows of its objects in the batch (m,), their features (m, C), gaze (m, R), its free space (R,)."""

    rows: NDArray[np.int64]
    features: Floats
    gaze: Floats
    space: Floats


class GeodesicQuery:
    """Embeds one place at a time, with the weights that the encoder has now.

    Args:
        encoder: on the CPU.

    """

    def __init__(self, encoder: GeodesicAttentionEncoder) -> None:
        config = encoder.config
        self._centres = np.array(config.centres)
        self._widths = np.array(config.widths)
        self._sink, self._space_weight = config.sink, config.space_weight
        self._root = math.sqrt(config.sink)
        with torch.no_grad():
            self._score = np.exp(as_array(encoder.score))  # (R, C)
            self._value, self._bias = as_array(encoder.value.weight), as_array(encoder.value.bias)  # (D, R·C + R), (D,)

    @staticmethod
    def fits(encoder: object, batch: Batch) -> TypeGuard[GeodesicAttentionEncoder]:
        """Whether an encoder and a batch are of the kind that this is for."""
        return (
            type(encoder) is GeodesicAttentionEncoder
            and batch.n_roots == 1
            and batch.features.shape[1] == encoder.n_classes
            and len(batch.edges_within) == 1
            and not batch.features.requires_grad
            and (encoder.config.space_weight == 0 or _bands(batch) == len(encoder.config.centres))
        )

    def encode(self, batch: Batch) -> Encoded:
        """Embed, with each object's share of the attention, as `GeodesicAttentionEncoder.encode` does.

        Args:
            batch: of one place, for which `fits` holds.

        """
        star = self._star(batch)
        counts = star.gaze.T @ star.features
        found = self._found(counts[None], star.space)
        z = self._unit(found)[0]
        reached = np.maximum(found[0] * (z @ self._value), 0.0)
        of_objects = (reached / max(reached.sum(), TINY))[: counts.size].reshape(counts.shape)
        per_count = np.divide(of_objects, counts, out=np.zeros_like(counts), where=counts > 0)
        parts = (star.gaze * (star.features @ per_count.T)).sum(1)
        credit = np.zeros(batch.n_nodes, dtype=np.float32)
        credit[star.rows] = parts
        rest = np.array([max(0.0, 1.0 - parts.sum())], dtype=np.float32)
        return Encoded(torch.from_numpy(z[None].astype(np.float32)), torch.from_numpy(credit), torch.from_numpy(rest))

    def embed(self, batch: Batch, keep: NDArray[np.bool_]) -> Array:
        """(K, D) embeddings of K variants of one place.

        Args:
            batch: of one place, for which `fits` holds.
            keep: (K, N) which nodes stay; the others are removed, as in `GeodesicAttentionEncoder.forward`.

        """
        star = self._star(batch)
        at_once = max(1, VALUES_AT_ONCE // max(1, star.features.size))
        parts = []
        for start in range(0, len(keep), at_once):
            stays = keep[start : start + at_once][:, star.rows]
            counts = star.gaze.T @ (star.features * stays[:, :, None])
            parts.append(self._unit(self._found(counts, star.space)).astype(np.float32))
        return np.concatenate(parts)

    def _star(self, batch: Batch) -> _Star:
        source, length = batch.edge_index.numpy()[0], batch.edge_length.numpy()
        stays = batch.is_object.numpy()[source]
        if not stays.all():
            source, length = source[stays], length[stays]
        gaze = np.exp(-0.5 * ((length[:, None] - self._centres) / self._widths) ** 2)
        space = np.zeros(0)
        if self._space_weight > 0 and batch.free_space is not None:
            space = self._space_weight * np.sqrt(batch.free_space.numpy()[0].astype(np.float64))
        return _Star(source, batch.features.numpy()[source].astype(np.float64), gaze, space)

    def _found(self, counts: Floats, space: Floats) -> Floats:
        """(K, R, C) counts and what free space adds -> (K, R·C + R)."""
        x = (np.sqrt(np.maximum(counts, 0.0) + self._sink) - self._root) * self._score
        x = x.reshape(len(counts), -1)
        x /= np.sqrt(1.0 + np.einsum("kx,kx->k", x, x))[:, None]
        return np.concatenate([x, np.broadcast_to(space, (len(x), len(space)))], axis=1)

    def _unit(self, found: Floats) -> Floats:
        z = found @ self._value.T + self._bias
        unit: Floats = z / np.maximum(np.sqrt(np.einsum("kd,kd->k", z, z)), TINY)[:, None]
        return unit


def _bands(batch: Batch) -> int:
    return -1 if batch.free_space is None else int(batch.free_space.shape[1])
