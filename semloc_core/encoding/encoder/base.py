"""What every encoder is: a function from a batch of places to unit vectors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import msgspec
import torch
from torch import Tensor, nn

from semloc_core.encoding.encoder.discriminant import Pairs
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.errors import ConfigError, ModelError
from semloc_core.text import short_repr

S = TypeVar("S", bound=msgspec.Struct)


@short_repr
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
    """Base class. ``config`` is a frozen msgspec struct of ``config_type``, enough to build the encoder again.

    Every encoder is built as ``EncoderClass(config, n_classes, generator)``; the generator gives the initial
    weights (one seeded with 0 where it is None).
    """

    name: ClassVar[str]
    config_type: ClassVar[type[msgspec.Struct]]
    counts_objects: ClassVar[bool] = True
    """Whether an object whose features are multiplied by w counts as w objects do; else weights are left out."""
    config: Any
    n_classes: int

    def __init__(self, config: Any, n_classes: int, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.config = check_config(self.name, self.config_type, config)
        if n_classes < 1:
            raise ConfigError(f"expected at least one class for encoder '{self.name}' (got {n_classes})")
        self.n_classes = n_classes

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.n_classes} classes, {self.dimension} numbers a place)"

    @property
    @abstractmethod
    def extraction(self) -> Extraction:
        """What `semloc_core.encoding.place_graph` must extract."""

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

    def contributions(self, batch: Batch, z_map: Tensor) -> Tensor | None:
        """Exact additive parts of a similarity, for encoders whose embedding is a sum over objects.

        Args:
            batch: B query places.
            z_map: (B, D) or (D,) embeddings of the map places that they are compared with.

        Returns:
            (N,) float32: what each node adds to the scalar product of its root's embedding with ``z_map``; the
            nodes of one root sum to that product. None for encoders without a closed form.

        """
        return None

    def fit(self, batches: Iterable[Batch]) -> None:
        """Set what is counted on map graphs and not learned by gradient (inverse document frequencies)."""

    def warm_start(self, pairs: Iterable[Pairs]) -> None:
        """Begin with better weights than random ones, from pairs of views of places; nothing unless overridden."""

    @property
    def trainable(self) -> bool:
        """Whether there are weights to learn."""
        return any(True for _ in self.parameters())

    def check_batch(self, batch: Batch) -> None:
        """Raise ModelError where a batch has other classes than the encoder."""
        if batch.features.shape[1] != self.n_classes:
            raise ModelError(f"expected features of {self.n_classes} classes (got {batch.features.shape[1]})")


def check_config(name: str, config_type: type[S], config: msgspec.Struct | Mapping[str, Any] | None) -> S:
    """Turn what a user gave into a validated configuration.

    Through JSON and back, so that constraints are checked whoever made the struct, a NaN is refused, and a
    configuration is always one that a checkpoint can carry.

    Raises:
        ConfigError: an unknown option, a wrong type or a value out of range.

    """
    if config is None:
        return config_type()
    try:
        return msgspec.json.decode(msgspec.json.encode(config), type=config_type)
    except (msgspec.ValidationError, msgspec.DecodeError, TypeError) as error:
        raise ConfigError(f"expected a valid configuration of encoder '{name}' (got {config}: {error})") from error


def start_generator(generator: torch.Generator | None) -> torch.Generator:
    """The given generator, or one seeded with 0: initial weights never come from the global one."""
    return generator if generator is not None else torch.Generator().manual_seed(0)
