"""Which few buildings of a large map a robot answers from: those that the places most like its own lie in."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.fleet.source import Nearest

STAYING = 0.5
"""A building that is on the list keeps its place as if it ranked so much higher: a list that changes costs time."""


class ShortlistConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How much of a large map a robot takes to itself."""

    nearest: Annotated[int, Meta(ge=1, le=16_384, description="places asked of the server, the most similar")] = 1600
    buildings: Annotated[int, Meta(ge=1, le=1000, description="buildings to answer from at most")] = 64
    places: Annotated[int, Meta(ge=1, description="places to answer from at most; one building may have more")] = 50_000
    kept_places: Annotated[
        int, Meta(ge=1, description="places of buildings kept in case they are proposed again, at most")
    ] = 100_000


def shortlist(
    nearest: Nearest,
    sizes: Mapping[str, int],
    temperature: float,
    config: ShortlistConfig,
    current: Collection[str] = (),
    believed: Collection[str] = (),
) -> tuple[str, ...]:
    """Choose buildings.

    A building's weight is what a softmax over the places found gives to its places: the same that an answer by
    similarity would. Those on the list already are counted up (`STAYING`), but only while they are proposed.

    Args:
        nearest: the places most like the query's.
        sizes: places of each building of the map; others are left out.
        temperature: of the softmax.
        config: limits.
        current: buildings on the list so far.
        believed: buildings that a filter believes the robot to be in: they come first, proposed or not.

    Returns:
        Names, the likeliest first.

    """
    weights: dict[str, float] = {}
    similarities = nearest.similarities.astype(np.float64)
    powers = np.exp((similarities - similarities.max(initial=-np.inf)) / temperature)
    for name, weight in zip(nearest.buildings, powers.tolist(), strict=True):
        if name in sizes:
            weights[name] = weights.get(name, 0.0) + weight
    ranked = sorted(weights, key=lambda name: (-weights[name], name))
    place = {name: rank * (STAYING if name in current else 1.0) for rank, name in enumerate(ranked)}
    place |= dict.fromkeys((name for name in believed if name in sizes), -1.0)
    chosen: list[str] = []
    places = 0
    for name in sorted(place, key=lambda name: (place[name], name)):
        if len(chosen) == config.buildings:
            break
        if not chosen or places + sizes[name] <= config.places:
            chosen.append(name)
            places += sizes[name]
    return tuple(chosen)
