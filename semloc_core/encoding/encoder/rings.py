"""Soft geodesic rings: class counts by distance, a descriptor by hand whose attributions are exact."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from semloc_core.encoding.encoder.bands import BandsConfig, BandsEncoder, Centres, Widths
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction

FADED = 3.0  # widths from its centre at which a Gaussian counts for nothing (1 %)


class RingsConfig(BandsConfig, frozen=True, forbid_unknown_fields=True):
    """Options of the rings.

    Args:
        centres: geodesic distance at which each ring is centred, metres.
        widths: standard deviation of each ring, metres.

    """

    centres: Centres = (0.0, 2.0, 4.0, 7.0, 11.0, 16.0)
    widths: Widths = (1.0, 1.0, 1.5, 2.0, 3.0, 4.0)


class RingsEncoder(BandsEncoder):
    """R rings × C classes: √(Σ_objects exp(-½((d - centre)/width)²) · class), scaled to unit length.

    d is the geodesic distance from the place to the object's parent place. The square root makes the scalar
    product of two embeddings the Bhattacharyya coefficient of their histograms. A place with no object in reach
    has a zero row. Objects of a class that the labelspace lacks count for nothing. Scaling all features alike
    changes nothing, so Integrated Gradients from a zero baseline has no meaning here: use `contributions`.
    """

    name: ClassVar[str] = "rings"
    config_type = RingsConfig
    config: RingsConfig

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
        return _unit(_sqrt(self.counts(batch, *self.edges(batch, keep)))).flatten(1)

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor:
        """Share each dimension's product z_k · m_k among objects in proportion to their weight in dimension k.

        Args:
            batch: B query places.
            z_map: (B, D) or (D,) embeddings of the map places.

        Returns:
            (N,) float32; the nodes of one root sum to the scalar product of its embedding with its map place's.

        """
        edges = self.edges(batch, None)
        counts = self.counts(batch, *edges)
        product = _unit(_sqrt(counts)) * z_map.expand(batch.n_roots, -1).view_as(counts)
        parts = self.share(batch, *edges, counts, product)
        return parts.new_zeros(batch.n_nodes).index_add_(0, edges[0], parts)


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
