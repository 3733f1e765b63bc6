"""What every encoder is: a function from a batch of places to unit vectors, and how its input is extracted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from torch import Tensor, nn

from semloc_core.place_graph import Batch


@dataclass(frozen=True)
class Extraction:
    """Which surroundings of a place an encoder reads.

    Args:
        kind: ``ego``: the subgraph of ``hops`` hops over traversability and visibility edges (message passing);
            ``reach``: a star, one edge to the place from every object within ``radius_m`` of it, with its
            geodesic distance (place -> parent place along traversability edges) as edge length.
        hops: number of hops (``ego``; 1 for ``reach``).
        radius_m: ``ego``: objects see and are seen up to this geodesic distance from their parent place (the
            visibility radius); ``reach``: how far the star reaches. Metres.

    """

    kind: Literal["ego", "reach"]
    hops: int
    radius_m: float


@dataclass(frozen=True, eq=False)
class Encoded:
    """Embeddings and what attention gave them.

    Args:
        embedding: (B, D) float32, rows of unit length (a zero row where nothing can be said).
        credit: (N,) float32 ≥ 0: how much of its root's attention comes from a node; zero for places, or None
            for an encoder that has no attention.
        self_share: (B,) the part of the attention that went to no object (self-loops, places), or None.

    """

    embedding: Tensor
    credit: Tensor | None
    self_share: Tensor | None


class Encoder(nn.Module, ABC):
    """Base class. ``config`` is a frozen msgspec struct, enough to build the encoder again."""

    name: ClassVar[str]
    config: Any
    n_classes: int

    @property
    @abstractmethod
    def extraction(self) -> Extraction:
        """What `semloc_core.place_graph` must extract."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """D, numbers per place."""

    @abstractmethod
    def forward(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """Embed.

        Args:
            batch: B places. Gradients flow to ``batch.features``.
            keep: (N,) bool or None; nodes where it is false are *removed*: they send nothing (a zeroed node
                would still count in a sum and in a softmax). Roots can't be removed.

        Returns:
            (B, D) float32 of unit rows.

        """

    def encode(self, batch: Batch) -> Encoded:
        """Embed, and say where the attention went, in one pass; without attention unless overridden."""
        return Encoded(embedding=self(batch), credit=None, self_share=None)

    def contributions(self, batch: Batch, target: Tensor) -> Tensor | None:
        """Take the similarity of one query place to a map embedding exactly apart, where the encoder can.

        Args:
            batch: one query place, N nodes.
            target: (D,) the map place's embedding.

        Returns:
            (N,) float32, zero for places, summing to the similarity; None for an encoder that is no sum over objects.

        """
        return None
