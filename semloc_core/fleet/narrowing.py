"""Which few buildings of a large map a robot answers from: those that speak for themselves by objects and places."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import zip_longest
from typing import Annotated

import msgspec
from msgspec import Meta

SIMILAR = 0.06
"""Nats for each temperature of similarity; chosen on 1,000 generated homes, as the votes' weights."""
SURE = 1 / 12
"""Of a new list the part, its best, that has to be on the list at hand for that to stay: making one costs time."""
ANEW_M, ANEW_OBJECTS = 1.0, 1.25
"""A list is looked at again when so many metres were walked, or so many times as many objects are known."""


class ShortlistConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How much of a large map a robot takes to itself."""

    nearest: Annotated[int, Meta(ge=1, le=16_384, description="places asked of the server, the most similar")] = 1600
    buildings: Annotated[int, Meta(ge=1, le=1000, description="buildings to answer from at most")] = 384
    places: Annotated[int, Meta(ge=1, description="places to answer from at most; one building may have more")] = (
        100_000
    )
    kept_places: Annotated[
        int, Meta(ge=1, description="places of buildings kept in case they are proposed again, at most")
    ] = 200_000


def shortlist(
    similar: Mapping[str, float],
    votes: Mapping[str, float],
    sizes: Mapping[str, int],
    temperature: float,
    config: ShortlistConfig,
    believed: Collection[str] = (),
) -> tuple[str, ...]:
    """Choose buildings.

    They are ranked by what the objects seen say for them, and by how similar the most similar of their places is. Those
    that the map does not say the objects of (written before maps did) are ranked by similarity alone, and take turns
    with the others.

    Args:
        similar: similarity of a building's most similar place; of the others it is no higher than the lowest here.
        votes: of each building whose objects are known, nats (`ObjectVotes.scores`).
        sizes: places of each building of the map; others are left out.
        temperature: of similarity.
        config: limits.
        believed: buildings that a filter believes the robot to be in: they come first, proposed or not.

    Returns:
        Names, the likeliest first.

    """
    least, weight = min(similar.values(), default=0.0), SIMILAR / temperature
    scores = {n: votes[n] + weight * (similar.get(n, least) - least) for n in sizes if n in votes}
    unsaid = {name: similar[name] for name in sizes if name in similar and name not in votes}
    turns = zip_longest(*(sorted(each, key=lambda name: (-each[name], name)) for each in (scores, unsaid)))
    ranked = [name for name in believed if name in sizes]
    ranked += [name for turn in turns for name in turn if name is not None]
    chosen: list[str] = []
    places = 0
    for name in dict.fromkeys(ranked):
        if len(chosen) == config.buildings:
            break
        if not chosen or places + sizes[name] <= config.places:
            chosen.append(name)
            places += sizes[name]
    return tuple(chosen)
