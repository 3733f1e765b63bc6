"""Fragments: what a robot's graph holds after a few metres, as training queries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semloc_core.encoding import Batch, Extraction, reach_all_batch, union
from semloc_core.errors import ConfigError
from semloc_core.graph import Floats, GraphArrays
from semloc_core.sources import WalkConfig, walks_through
from semloc_core.text import short_repr

SHORTEST_M = 1.0
"""Least distance walked before a fragment is cut, but for those at the start."""


@short_repr
@dataclass(frozen=True, eq=False)
class Fragments:
    """Query places, each with what had been seen when the robot stood there.

    Args:
        batch: B stars.
        positions: (B, 3) float64, metres.

    """

    batch: Batch
    positions: Floats


def draw_fragments(
    graph: GraphArrays,
    n_classes: int,
    extraction: Extraction,
    rng: np.random.Generator,
    walks: int,
    stops: int,
    longest_m: float,
    range_m: float = 4.0,
) -> Fragments | None:
    """Walk through a building from random places and cut out what has been seen.

    The robot is stopped where it starts, and at distances spread evenly in their logarithm up to ``longest_m``.

    Args:
        graph: the building as this run perceives it.
        n_classes: C.
        extraction: what the encoder reads; stars only.
        rng: source of randomness.
        walks: how many walks.
        stops: fragments a walk, at most (two stops may be one place).
        longest_m: length of a walk, metres.
        range_m: what is within this geodesic distance of the way has been seen, metres.

    Returns:
        The fragments; None where there is nowhere to walk.

    Raises:
        ConfigError: an encoder that does not read stars.

    """
    if extraction.kind != "reach":
        raise ConfigError(f"expected an encoder that reads stars, to train on fragments (got '{extraction.kind}')")
    parts: list[Batch] = []
    positions: list[Floats] = []
    config = WalkConfig(distance_m=max(longest_m, SHORTEST_M), range_m=range_m)
    for way in walks_through(graph, config, rng, walks):
        far = np.exp(rng.uniform(math.log(SHORTEST_M), math.log(config.distance_m), max(stops - 1, 0)))
        steps = np.unique(np.searchsorted(way.metres, np.concatenate([[0.0], far])).clip(max=way.steps - 1))
        for step in steps.tolist():
            part, place = way.part(step)
            roots = np.array([place], dtype=np.int64)
            parts.append(reach_all_batch(part, n_classes, extraction.radius_m, roots, extraction.bands))
        positions.append(way.truth()[steps])
    return Fragments(union(parts)[0], np.concatenate(positions)) if parts else None


def join(fragments: Sequence[Fragments]) -> tuple[Batch, list[Floats]]:
    """One batch of several buildings' fragments, and the positions of each."""
    return union([part.batch for part in fragments])[0], [part.positions for part in fragments]
