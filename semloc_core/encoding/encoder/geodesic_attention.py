"""Attention over all objects in reach by class and geodesic distance, in a space learned on map graphs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar

import msgspec
import torch
from msgspec import Meta
from torch import Tensor, nn

from semloc_core.encoding.encoder.bands import BandsConfig, BandsEncoder, Centres, Widths
from semloc_core.encoding.encoder.base import Encoded, start_generator
from semloc_core.encoding.encoder.discriminant import Discriminant, Pairs
from semloc_core.encoding.encoder.layers import Linear
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.errors import ModelError

TINY = 1e-12  # a zero vector stays zero


class GeodesicAttentionConfig(BandsConfig, frozen=True, forbid_unknown_fields=True):
    """Options of geodesic attention.

    Args:
        centres: geodesic distance at which each head looks, metres.
        widths: standard deviation of each head's gaze, metres.
        radius_m: how far objects and free space are read, metres.
        dimension: numbers per embedding.
        sink: attention that a head keeps to itself, in objects: how little a faint object counts.
        space_weight: scale of free space beside objects; 0 leaves it out.

    """

    centres: Centres = (0.0, 3.0, 6.0, 10.0, 15.0, 21.0, 28.0, 38.0)
    widths: Widths = (1.6, 1.8, 2.2, 2.8, 3.5, 4.5, 6.0, 8.0)
    radius_m: Annotated[float, Meta(gt=0, le=1000)] = 40.0
    dimension: Annotated[int, Meta(ge=2, le=1024)] = 64
    sink: Annotated[float, Meta(gt=0, le=10)] = 0.005
    space_weight: Annotated[float, Meta(ge=0, le=10)] = 0.07


class GeodesicAttentionEncoder(BandsEncoder):
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
        counts = self.counts(batch, *self.edges(batch, keep))
        return self._found(batch, counts)

    def encode(self, batch: Batch) -> Encoded:
        """Embed, with each object's share of the attention; see the class. Free space's share is ``self_share``."""
        source, target, gaze = self.edges(batch, None)
        counts = self.counts(batch, source, target, gaze)
        found = self._found(batch, counts)
        embedding = _unit(self.value(found))
        reached = (found * (embedding @ self.value.weight)).clamp_min(0.0)  # x_k w_k·z of every head
        total = reached.sum(1, keepdim=True).clamp_min(TINY)
        of_objects = (reached / total)[:, : counts[0].numel()].view_as(counts)
        parts = self.share(batch, source, target, gaze, counts, of_objects)
        credit = parts.new_zeros(batch.n_nodes).index_add_(0, source, parts)
        given = parts.new_zeros(batch.n_roots).index_add_(0, target, parts)
        return Encoded(embedding, credit.detach(), (1.0 - given).clamp_min(0.0).detach())

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor:
        """Exact parts of a similarity, given the attention: an object's own, and the rest at the place itself.

        See the base class. The rest is what free space and bias add.
        """
        source, target, gaze = self.edges(batch, None)
        counts = self.counts(batch, source, target, gaze)
        found = self._found(batch, counts)
        z = self.value(found)
        towards = z_map.expand(batch.n_roots, -1) / torch.linalg.vector_norm(z, dim=1, keepdim=True).clamp_min(TINY)
        terms = found * (towards @ self.value.weight)
        of_objects = terms[:, : counts[0].numel()].view_as(counts)
        parts = self.share(batch, source, target, gaze, counts, of_objects)
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


def _unit(z: Tensor) -> Tensor:
    length: Tensor = torch.linalg.vector_norm(z, dim=1, keepdim=True)
    return z / length.clamp_min(TINY)
