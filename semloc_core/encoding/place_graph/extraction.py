"""Which surroundings of a place an encoder reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from semloc_core.text import short_repr


@short_repr
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
        bands: ``reach``: bands of geodesic distance (centre and width, metres) in which the free space around the
            place is measured (`semloc_core.encoding.place_graph.free_space`); none: it is not.

    """

    kind: Literal["ego", "reach"]
    hops: int
    radius_m: float
    bands: tuple[tuple[float, float], ...] = ()

    @property
    def visibility_m(self) -> float:
        """Radius up to which an online graph must keep track of who sees what; 0 where nobody asks, metres."""
        return self.radius_m if self.kind == "ego" else 0.0
