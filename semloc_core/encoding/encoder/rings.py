"""Soft geodesic rings: class counts by distance, a descriptor by hand whose attributions are exact."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.errors import ConfigError

FADED = 3.0  # widths from its centre at which a Gaussian counts for nothing (1 %)


class RingsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the rings.

    Args:
        centres: geodesic distance at which each ring is centred, metres.
        widths: standard deviation of each ring, metres.

    """

    centres: Annotated[tuple[Annotated[float, Meta(ge=0, le=1000)], ...], Meta(min_length=1, max_length=64)] = (
        0.0,
        2.0,
        4.0,
        7.0,
        11.0,
        16.0,
    )
    widths: Annotated[tuple[Annotated[float, Meta(gt=0, le=1000)], ...], Meta(min_length=1, max_length=64)] = (
        1.0,
        1.0,
        1.5,
        2.0,
        3.0,
        4.0,
    )

    def __post_init__(self) -> None:
        if len(self.centres) != len(self.widths):
            raise ConfigError(f"expected as many widths as centres (got {len(self.widths)} and {len(self.centres)})")


class RingsEncoder(Encoder):
    """R rings × C classes: √(Σ_objects exp(-½((d - centre)/width)²) · class), scaled to unit length.

    d is the geodesic distance from the place to the object's parent place. The square root makes the scalar
    product of two embeddings the Bhattacharyya coefficient of their histograms. A place with no object in reach
    has a zero row. Objects of a class that the labelspace lacks count for nothing. Scaling all features alike
    changes nothing, so Integrated Gradients from a zero baseline has no meaning here: use `contributions`.
    """

    name: ClassVar[str] = "rings"
    config_type = RingsConfig
    config: RingsConfig

    def __init__(self, config: RingsConfig | None, n_classes: int, generator: torch.Generator | None = None) -> None:
        super().__init__(config, n_classes)

    @property
    def extraction(self) -> Extraction:
        """Every object up to where the outermost ring has faded."""
        reach = max(c + FADED * w for c, w in zip(self.config.centres, self.config.widths, strict=True))
        return Extraction("reach", 1, reach)

    @property
    def dimension(self) -> int:
        """R · C, ring by ring."""
        return len(self.config.centres) * self.n_classes

    def forward(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """Embed; see the base class. Gradients at empty dimensions are zero, never infinite."""
        source, target, weight = self._weights(batch, keep)
        return _unit(_sqrt(self._counts(batch, source, target, weight))).flatten(1)

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor:
        """Share each dimension's product z_k · m_k among objects in proportion to their weight in dimension k.

        Args:
            batch: B query places.
            z_map: (B, D) or (D,) embeddings of the map places.

        Returns:
            (N,) float32; the nodes of one root sum to the scalar product of its embedding with its map place's.

        """
        source, target, weight = self._weights(batch, None)
        counts = self._counts(batch, source, target, weight)
        product = _unit(_sqrt(counts)) * z_map.expand(batch.n_roots, -1).view_as(counts)
        per_count = torch.where(counts > 0, product / counts.clamp_min(torch.finfo(counts.dtype).tiny), 0.0)
        features = batch.features.index_select(0, source)
        parts = features.new_zeros(features.shape[0])
        for r in range(weight.shape[1]):
            parts += weight[:, r] * (features * per_count[:, r].index_select(0, target)).sum(1)
        return parts.new_zeros(batch.n_nodes).index_add_(0, source, parts)

    def _weights(self, batch: Batch, keep: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Sources (E,), targets (E,) and ring weights (E, R) of the edges that arrive at roots."""
        self.check_batch(batch)
        count = batch.edges_within[0] if batch.edges_within else 0
        (source, target), length = batch.edge_index[:, :count], batch.edge_length[:count]
        if keep is not None:
            stays = keep.index_select(0, source)
            source, target, length = source[stays], target[stays], length[stays]
        centres, widths = length.new_tensor(self.config.centres), length.new_tensor(self.config.widths)
        return source, target, torch.exp(-0.5 * ((length[:, None] - centres) / widths) ** 2)

    def _counts(self, batch: Batch, source: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """(B, R, C) soft counts; a ring at a time, so that no (E, R, C) is ever held."""
        features = batch.features.index_select(0, source)
        empty = features.new_zeros(batch.n_roots, self.n_classes)
        rings = [empty.index_add(0, target, features * weight[:, r : r + 1]) for r in range(weight.shape[1])]
        return torch.stack(rings, dim=1)


def _sqrt(x: Tensor) -> Tensor:
    """√x with gradient 0 where x ≤ 0 (the root's own is infinite at 0)."""
    positive = x > 0
    return torch.where(positive, torch.sqrt(torch.where(positive, x, 1.0)), 0.0)


def _unit(x: Tensor) -> Tensor:
    """Rows (all but the first dimension together) of unit length; a zero row stays zero, with zero gradient."""
    squared = x.flatten(1).square().sum(1)
    some = squared > 0
    scale = torch.where(some, torch.rsqrt(torch.where(some, squared, 1.0)), 0.0)
    return x * scale.view(-1, *[1] * (x.dim() - 1))
