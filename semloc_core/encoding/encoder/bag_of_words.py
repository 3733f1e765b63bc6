"""Class counts: bag of words (the paper's baseline), TF-IDF, and the 13 m histogram of Hydra's loop closure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, ClassVar

import msgspec
import torch
import torch.nn.functional as F
from msgspec import Meta
from torch import Tensor

from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction


class BagOfWordsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of `BagOfWordsEncoder` and `TfidfEncoder`.

    Args:
        visibility_radius_m: an object is seen from places up to this geodesic distance from its parent place.

    """

    visibility_radius_m: Annotated[float, Meta(gt=0, le=100)] = 4.0


class HistogramConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of `HistogramEncoder`.

    Args:
        radius_m: objects whose parent place is within this geodesic distance of the place are counted.

    """

    radius_m: Annotated[float, Meta(gt=0, le=1000)] = 13.0


class BagOfWordsEncoder(Encoder):
    """Objects visible from a place, counted by class and scaled to unit length: the baseline of the paper's Table II.

    One hop over visibility edges, so that explicit sightings count. A place that sees nothing has a zero row.
    """

    name: ClassVar[str] = "bag_of_words"
    config_type: ClassVar[type[msgspec.Struct]] = BagOfWordsConfig

    @property
    def extraction(self) -> Extraction:
        """What the place itself sees."""
        return Extraction("ego", 1, self.config.visibility_radius_m)

    @property
    def dimension(self) -> int:
        """One number a class."""
        return self.n_classes

    def forward(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """Embed; see the base class."""
        return F.normalize(self._weigh(self._counts(batch, keep)), dim=1)

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor:
        """Each object's own term of the scalar product; see the base class."""
        source, target = self._edges(batch, None)
        length = torch.linalg.vector_norm(self._weigh(self._counts(batch, None)), dim=1, keepdim=True)
        unit = z_map.expand(batch.n_roots, -1) / length.clamp_min(1e-12)
        parts: Tensor = (self._weigh(batch.features.index_select(0, source)) * unit.index_select(0, target)).sum(1)
        return parts.new_zeros(batch.n_nodes).index_add_(0, source, parts)

    def _weigh(self, counts: Tensor) -> Tensor:
        """Weights by class; none here."""
        return counts

    def _edges(self, batch: Batch, keep: Tensor | None) -> tuple[Tensor, Tensor]:
        """Edges from objects to roots."""
        self.check_batch(batch)
        source, target = batch.edge_index[:, : batch.edges_within[0] if batch.edges_within else 0]
        stays = batch.is_object if keep is None else batch.is_object & keep
        stays = stays.index_select(0, source)
        return source[stays], target[stays]

    def _counts(self, batch: Batch, keep: Tensor | None) -> Tensor:
        """(B, C) objects of each class."""
        source, target = self._edges(batch, keep)
        features = batch.features.index_select(0, source)
        return features.new_zeros(batch.n_roots, self.n_classes).index_add(0, target, features)


class TfidfEncoder(BagOfWordsEncoder):
    """Bag of words, each class weighted by log((1 + places) / (1 + places that see it)) + 1, counted on map graphs.

    The smooth form of scikit-learn's ``TfidfTransformer``. Before `fit` all weights are 1.
    """

    name: ClassVar[str] = "tfidf"

    idf: Tensor

    def __init__(self, config: Any, n_classes: int, generator: torch.Generator | None = None) -> None:
        super().__init__(config, n_classes)
        self.register_buffer("idf", torch.ones(n_classes))

    def fit(self, batches: Iterable[Batch]) -> None:
        """Count, over the places of all batches, how many see each class; what was counted before is forgotten."""
        places, seen = 0, torch.zeros(self.n_classes, dtype=torch.float64)
        with torch.no_grad():
            for batch in batches:
                places += batch.n_roots
                seen += (self._counts(batch, None) > 0).sum(0).to(seen)
        self.idf.copy_(torch.log((1 + places) / (1 + seen)) + 1)

    def _weigh(self, counts: Tensor) -> Tensor:
        return counts * self.idf


class HistogramEncoder(BagOfWordsEncoder):
    """Classes of all objects within a radius: the object descriptor of Hydra's loop closure detection.

    Hughes et al., "Hydra: A Real-time Spatial Perception System for 3D Scene Graph Construction and
    Optimization", RSS 2022: a histogram of object classes in a neighbourhood, 13 m by default. Here the
    neighbourhood is geodesic and the comparison a cosine.
    """

    name: ClassVar[str] = "histogram"
    config_type = HistogramConfig

    @property
    def extraction(self) -> Extraction:
        """Every object in the radius."""
        return Extraction("reach", 1, self.config.radius_m)
