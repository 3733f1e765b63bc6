"""Attention over all objects in reach by class and geodesic distance, in a space learned on map graphs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar

import msgspec
import torch
from msgspec import Meta
from torch import Tensor, nn

from semloc_core.encoding.encoder.base import Encoded, Encoder, start_generator
from semloc_core.encoding.encoder.discriminant import Discriminant, Pairs
from semloc_core.encoding.encoder.layers import Linear
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.errors import ConfigError, ModelError

TINY = 1e-12  # a zero vector stays zero

Metres = Annotated[float, Meta(ge=0, le=1000)]


class GeodesicAttentionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of geodesic attention.

    Args:
        centres: geodesic distance at which each head looks, metres.
        widths: standard deviation of each head's gaze, metres.
        radius_m: how far objects and free space are read, metres.
        dimension: numbers per embedding.
        sink: attention that a head keeps to itself, in objects: how little a faint object counts.
        space_weight: scale of free space beside objects; 0 leaves it out.

    """

    centres: Annotated[tuple[Metres, ...], Meta(min_length=1, max_length=64)] = (
        0.0,
        3.0,
        6.0,
        10.0,
        15.0,
        21.0,
        28.0,
        38.0,
    )
    widths: Annotated[tuple[Annotated[float, Meta(gt=0, le=1000)], ...], Meta(min_length=1, max_length=64)] = (
        1.6,
        1.8,
        2.2,
        2.8,
        3.5,
        4.5,
        6.0,
        8.0,
    )
    radius_m: Annotated[float, Meta(gt=0, le=1000)] = 40.0
    dimension: Annotated[int, Meta(ge=2, le=1024)] = 64
    sink: Annotated[float, Meta(gt=0, le=10)] = 0.005
    space_weight: Annotated[float, Meta(ge=0, le=10)] = 0.07

    def __post_init__(self) -> None:
        if len(self.centres) != len(self.widths):
            raise ConfigError(f"expected as many widths as centres (got {len(self.widths)} and {len(self.centres)})")


class GeodesicAttentionEncoder(Encoder):
    r"""A place attends to every object in reach, and to the free space between, and maps what it finds to D numbers.

    Head (r, c) looks at objects of class c at about ``centres[r]`` metres. With d_o the geodesic distance,

        φ_ro = exp(-½((d_o - centre_r)/width_r)²),   N_rc = Σ_{o of class c} φ_ro,
        α_ro = e^{a_rc} φ_ro / (√(N_rc + s) + √s) / √(1 + Σ_rc x_rc²),   x_rc = e^{a_rc} (√(N_rc + s) - √s)
        z    = Σ_ro α_ro w_{r c(o)} + Σ_r √(A_r) u_r + b,  scaled to unit length.

    a (R, C) scores and w, u, b values are learned; s is the sink; A_r is the free space (m²) in the same bands.
    A softmax would forget how many objects there are, and a plain sum would let the many drown the few: objects of
    one class in one band share √N instead of 1 or N (as in soft rings), and all heads together share one norm.
    What is in z is a sum over objects, so a similarity comes apart exactly (`contributions`), and the share of the
    attention that an object gets is measured by what α w brings to z along z, where that is positive (Ferrando et al.,
    "Measuring the Mixing of Contextual Information in the Transformer", EMNLP 2022), not by α alone: its length
    (Kobayashi et al., EMNLP 2020) is nearly the same for all objects, because what all places share goes to the bias.

    Trained from a discriminant start (`warm_start`): directions in which different places differ and two views of
    one place do not (Fisher's criterion), which takes seconds and no gradient.
    """

    name: ClassVar[str] = "geodesic_attention"
    config_type: ClassVar[type[msgspec.Struct]] = GeodesicAttentionConfig
    config: GeodesicAttentionConfig

    def __init__(
        self, config: GeodesicAttentionConfig | None, n_classes: int, generator: torch.Generator | None = None
    ) -> None:
        super().__init__(config, n_classes)
        generator = start_generator(generator)
        heads = len(self.config.centres)
        self.score = nn.Parameter(torch.zeros(heads, n_classes))
        self.value = Linear(heads * n_classes + (heads if self.config.space_weight > 0 else 0), self.config.dimension)
        self.value.reset_parameters(generator)

    @property
    def extraction(self) -> Extraction:
        """Every object in reach, and the free space in each head's band."""
        c = self.config
        bands = tuple(zip(c.centres, c.widths, strict=True)) if c.space_weight > 0 else ()
        return Extraction("reach", 1, c.radius_m, bands)

    @property
    def dimension(self) -> int:
        """Numbers per embedding."""
        return self.config.dimension

    def forward(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """Embed; see the base class."""
        z: Tensor = self.value(self.attended(batch, keep))
        return _unit(z)

    def attended(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """(B, R·C + R) what the heads bring together, before the values: x / √(1 + ‖x‖²), then free space."""
        counts = self._counts(batch, *self._edges(batch, keep))
        return self._found(batch, counts)

    def encode(self, batch: Batch) -> Encoded:
        """Embed, with each object's share of the attention; see the class. Free space's share is ``self_share``."""
        source, target, gaze = self._edges(batch, None)
        counts = self._counts(batch, source, target, gaze)
        found = self._found(batch, counts)
        embedding = _unit(self.value(found))
        reached = (found * (embedding @ self.value.weight)).clamp_min(0.0)  # x_k w_k·z of every head
        total = reached.sum(1, keepdim=True).clamp_min(TINY)
        of_objects = (reached / total)[:, : counts[0].numel()].view_as(counts)
        parts = self._share(batch, source, target, gaze, counts, of_objects)
        credit = parts.new_zeros(batch.n_nodes).index_add_(0, source, parts)
        given = parts.new_zeros(batch.n_roots).index_add_(0, target, parts)
        return Encoded(embedding, credit.detach(), (1.0 - given).clamp_min(0.0).detach())

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor:
        """Exact parts of a similarity, given the attention: an object's own, and the rest at the place itself.

        See the base class. The rest is what free space and bias add.
        """
        source, target, gaze = self._edges(batch, None)
        counts = self._counts(batch, source, target, gaze)
        found = self._found(batch, counts)
        z = self.value(found)
        towards = z_map.expand(batch.n_roots, -1) / torch.linalg.vector_norm(z, dim=1, keepdim=True).clamp_min(TINY)
        terms = found * (towards @ self.value.weight)
        of_objects = terms[:, : counts[0].numel()].view_as(counts)
        parts = self._share(batch, source, target, gaze, counts, of_objects)
        result = parts.new_zeros(batch.n_nodes).index_add_(0, source, parts)
        rest = (z * towards).sum(1) - parts.new_zeros(batch.n_roots).index_add_(0, target, parts)
        result[: batch.n_roots] = rest
        return result

    def warm_start(self, pairs: Iterable[Pairs]) -> None:
        """Set values to discriminant directions (`semloc_core.encoding.encoder.discriminant`) and scores to zero."""
        with torch.no_grad():
            self.score.zero_()
            found = Discriminant()
            for pair in pairs:
                found.add(self.attended(pair.queries), self.attended(pair.places), pair.nearest, pair.weight)
            weight, bias = found.directions(self.dimension)
            self.value.weight.zero_()
            self.value.bias.zero_()
            self.value.weight[: len(weight)] = weight
            self.value.bias[: len(bias)] = bias

    def _edges(self, batch: Batch, keep: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Sources (E,), targets (E,) and gaze φ (E, R) of the edges that arrive at roots."""
        self.check_batch(batch)
        count = batch.edges_within[0] if batch.edges_within else 0
        (source, target), length = batch.edge_index[:, :count], batch.edge_length[:count]
        stays = batch.is_object if keep is None else batch.is_object & keep
        stays = stays.index_select(0, source)
        source, target, length = source[stays], target[stays], length[stays]
        centres, widths = length.new_tensor(self.config.centres), length.new_tensor(self.config.widths)
        return source, target, torch.exp(-0.5 * ((length[:, None] - centres) / widths) ** 2)

    def _counts(self, batch: Batch, source: Tensor, target: Tensor, gaze: Tensor) -> Tensor:
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

    def _found(self, batch: Batch, counts: Tensor) -> Tensor:
        """(B, R·C + R); see `attended`."""
        sink = self.config.sink
        x = (torch.sqrt(counts.clamp_min(0.0) + sink) - math.sqrt(sink)) * self.score.exp()
        x = x.flatten(1)
        x = x / torch.sqrt(1.0 + x.square().sum(1, keepdim=True))
        if self.config.space_weight == 0:
            return x
        if batch.free_space is None or batch.free_space.shape[1] != len(self.config.centres):
            raise ModelError(
                f"expected free space in {len(self.config.centres)} bands "
                f"(got {'none' if batch.free_space is None else batch.free_space.shape[1]})"
            )
        return torch.cat([x, self.config.space_weight * torch.sqrt(batch.free_space)], dim=1)

    def _share(
        self, batch: Batch, source: Tensor, target: Tensor, gaze: Tensor, counts: Tensor, amount: Tensor
    ) -> Tensor:
        """(E,) the ``amount`` (B, R, C) of every head shared among its objects in proportion to φ."""
        per_count = torch.where(counts > 0, amount / counts.clamp_min(torch.finfo(counts.dtype).tiny), 0.0)
        features = batch.features.index_select(0, source)
        parts = gaze.new_zeros(len(source))
        for r in range(gaze.shape[1]):
            parts = parts + gaze[:, r] * (features * per_count[:, r].index_select(0, target)).sum(1)
        return parts


def _unit(z: Tensor) -> Tensor:
    length: Tensor = torch.linalg.vector_norm(z, dim=1, keepdim=True)
    return z / length.clamp_min(TINY)
