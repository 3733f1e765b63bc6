"""Class counts in Gaussian bands of geodesic distance: what soft rings and geodesic attention read of a star."""

from __future__ import annotations

from typing import Annotated

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.errors import ConfigError

Centres = Annotated[tuple[Annotated[float, Meta(ge=0, le=1000)], ...], Meta(min_length=1, max_length=64)]
Widths = Annotated[tuple[Annotated[float, Meta(gt=0, le=1000)], ...], Meta(min_length=1, max_length=64)]


class BandsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """R bands: the distance that each is about, and its standard deviation, metres."""

    centres: Centres
    widths: Widths

    def __post_init__(self) -> None:
        if len(self.centres) != len(self.widths):
            raise ConfigError(f"expected as many widths as centres (got {len(self.widths)} and {len(self.centres)})")


class BandsEncoder(Encoder):
    """An encoder that counts R bands × C classes; how much an edge is in each band is its gaze φ (E, R)."""

    config: BandsConfig

    def edges(self, batch: Batch, keep: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Sources (E,), targets (E,) and gaze φ (E, R) of the edges that arrive at roots."""
        self.check_batch(batch)
        count = batch.edges_within[0] if batch.edges_within else 0
        (source, target), length = batch.edge_index[:, :count], batch.edge_length[:count]
        stays = batch.is_object if keep is None else batch.is_object & keep
        stays = stays.index_select(0, source)
        source, target, length = source[stays], target[stays], length[stays]
        centres, widths = length.new_tensor(self.config.centres), length.new_tensor(self.config.widths)
        return source, target, torch.exp(-0.5 * ((length[:, None] - centres) / widths) ** 2)

    def counts(self, batch: Batch, source: Tensor, target: Tensor, gaze: Tensor) -> Tensor:
        """N (B, R, C). Features that want a gradient are summed whole, others only where they are not zero."""
        heads, b, c = gaze.shape[1], batch.n_roots, self.n_classes
        features = batch.features.index_select(0, source)
        if features.requires_grad:
            empty = features.new_zeros(b, c)
            rings = [empty.index_add(0, target, features * gaze[:, r : r + 1]) for r in range(heads)]
            return torch.stack(rings, dim=1)
        edge, class_ = features.nonzero(as_tuple=True)
        seen = gaze.index_select(0, edge) * features[edge, class_][:, None]
        flat: Tensor = features.new_zeros(b * c, heads).index_add_(0, target.index_select(0, edge) * c + class_, seen)
        return flat.view(b, c, heads).transpose(1, 2)

    def share(
        self, batch: Batch, source: Tensor, target: Tensor, gaze: Tensor, counts: Tensor, amount: Tensor
    ) -> Tensor:
        """(E,) the ``amount`` (B, R, C) of every head shared among its objects in proportion to φ."""
        per_count = torch.where(counts > 0, amount / counts.clamp_min(torch.finfo(counts.dtype).tiny), 0.0)
        features = batch.features.index_select(0, source)
        parts = gaze.new_zeros(len(source))
        for r in range(gaze.shape[1]):
            parts = parts + gaze[:, r] * (features * per_count[:, r].index_select(0, target)).sum(1)
        return parts
