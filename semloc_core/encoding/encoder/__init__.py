"""Encoders by name. Each is a class in a file of its own; `build_encoder` makes one from its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import torch

from semloc_core.encoding.encoder.bag_of_words import BagOfWordsEncoder, HistogramEncoder, TfidfEncoder
from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.encoder.geodesic_attention import GeodesicAttentionEncoder
from semloc_core.encoding.encoder.paper.encoder import PaperEncoder
from semloc_core.encoding.encoder.rings import RingsEncoder
from semloc_core.errors import ConfigError

_ALL = (PaperEncoder, GeodesicAttentionEncoder, RingsEncoder, BagOfWordsEncoder, TfidfEncoder, HistogramEncoder)
ENCODERS: dict[str, type[Encoder]] = {encoder.name: encoder for encoder in _ALL}


def build_encoder(
    name: str,
    config: Mapping[str, Any] | msgspec.Struct | None,
    n_classes: int,
    generator: torch.Generator | None = None,
) -> Encoder:
    """Make an encoder.

    Args:
        name: a key of `ENCODERS`.
        config: its configuration, as a struct or as plain values; None for the defaults.
        n_classes: C, length of the labelspace.
        generator: source of the initial weights; one seeded with 0 where it is None.

    Raises:
        ConfigError: no such encoder, or a configuration that it does not take.

    """
    if name not in ENCODERS:
        raise ConfigError(f"expected an encoder among {', '.join(ENCODERS)} (got '{name}')")
    return ENCODERS[name](config, n_classes, generator)
