"""A home on another day: objects that a detector names otherwise, that are gone, that were moved."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from semloc_core.config import Share
from semloc_core.evaluate.relocalise import Arena
from semloc_core.graph import GraphArrays
from semloc_core.training import displace_objects, mislabel_objects

MOVED_M = 3.0
"""Standard deviation of how far an object was moved, metres, in x and in y."""


class AnotherDay(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Shares of the objects seen that changed since the building was mapped, beyond what its detector errs anyway."""

    mislabelled: Share = 0.2
    gone: Share = 0.3
    moved: Share = 0.2


def on_another_day(arena: Arena, day: AnotherDay, seed: int) -> Arena:
    """The same maps, asked about by buildings that have changed; the same changes whatever the labelspace."""
    each = (
        changed(query, day, len(arena.labelspace), np.random.default_rng([seed, b]))
        for b, query in enumerate(arena.queries)
    )
    return replace(arena, queries=tuple(each))


def changed(graph: GraphArrays, day: AnotherDay, n_classes: int, rng: np.random.Generator) -> GraphArrays:
    """A building on another day; ``rng`` is the only source of randomness."""
    which, moves, names = rng.spawn(3)
    gone, moved, wrong = which.random((3, graph.n_objects)) < np.array([[day.gone], [day.moved], [day.mislabelled]])
    graph = mislabel_objects(graph, n_classes, wrong, names)
    return displace_objects(graph, MOVED_M * moved, moves).with_objects(~gone)
