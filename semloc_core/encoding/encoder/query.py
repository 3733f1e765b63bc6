"""An encoder as a robot asks it: one place at a time, with weights that do not change."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.encoder.base import Encoded, Encoder
from semloc_core.encoding.encoder.geodesic_attention import GeodesicAttentionEncoder
from semloc_core.encoding.encoder.geodesic_query import GeodesicQuery
from semloc_core.encoding.encoder.paper.encoder import PaperEncoder
from semloc_core.encoding.encoder.paper.query import PaperQuery
from semloc_core.encoding.place_graph import Batch

FEW = 4
"""Variants of a place up to which the paper's encoder goes through them one by one."""


class QueryEncoder:
    """Embeds places by the fastest way there is for them; which one it is shows in nothing but rounding.

    Args:
        encoder: in eval mode; its weights as they are now are the ones used from then on.

    """

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        on_cpu = all(parameter.device.type == "cpu" for parameter in encoder.parameters())
        self._paper = PaperQuery(encoder) if type(encoder) is PaperEncoder and on_cpu else None
        self._geodesic = GeodesicQuery(encoder) if type(encoder) is GeodesicAttentionEncoder and on_cpu else None

    def encode(self, batch: Batch) -> Encoded:
        """Embed one place, and say where the attention went: `Encoder.encode`."""
        with np.errstate(all="ignore"):  # absurd weights give infinities without a word, as with torch
            if self._paper is not None and PaperQuery.fits(self.encoder, batch):
                return self._paper.encode(batch)
            if self._geodesic is not None and GeodesicQuery.fits(self.encoder, batch):
                return self._geodesic.encode(batch)
        with torch.inference_mode():
            return self.encoder.encode(batch)

    def embed(self, batch: Batch, keep: NDArray[np.bool_]) -> NDArray[np.float32] | None:
        """Embed variants of one place.

        Args:
            batch: one place, N nodes.
            keep: (K, N) which nodes stay.

        Returns:
            (K, D); None where a union of copies is the faster way, or the only one.

        """
        with np.errstate(all="ignore"):
            if self._geodesic is not None and GeodesicQuery.fits(self.encoder, batch):
                return self._geodesic.embed(batch, keep)
            if self._paper is not None and len(keep) <= FEW and PaperQuery.fits(self.encoder, batch):
                return self._paper.embed(batch, keep)
        return None
