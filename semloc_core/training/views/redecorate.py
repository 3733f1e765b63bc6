"""Other buildings on known floor plans: so that an encoder learns to tell places apart, not to know these by heart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semloc_core.graph import GraphArrays, nearest_parents

MOVED = 0.7
"""Probability that a building's objects are also put elsewhere."""
GROUPED = 0.4
"""Share of the objects put elsewhere that stand beside another one."""
SPREAD_M = 0.5
"""Standard deviation of x and of y of an object around the place it is put at, metres."""
GROUP_SPREAD_M = 0.8
"""The same around the object it is put beside, metres."""


def redecorate(graph: GraphArrays, others: Sequence[GraphArrays], rng: np.random.Generator) -> GraphArrays:
    """The same floor plan with other objects.

    Classes are kept, dealt out anew, or drawn from another building's, a third of the time each; then, more often
    than not, the objects are put at random places, some beside one another. Sightings are left out.

    Args:
        graph: the building.
        others: buildings whose mix of classes may be taken.
        rng: source of randomness.

    """
    n = graph.n_objects
    if n == 0 or graph.n_places == 0:
        return graph
    classes, kind = graph.object_classes, int(rng.integers(3))
    if kind == 1:
        classes = rng.permutation(classes)
    elif kind == 2:
        mix = others[int(rng.integers(len(others)))].object_classes
        classes = rng.choice(mix if len(mix) else classes, n)
    none = np.zeros((2, 0), dtype=np.int64)
    if rng.random() >= MOVED:
        return replace(graph, object_classes=classes, object_labels=None, sightings=none)
    positions = graph.place_positions[rng.integers(graph.n_places, size=n)].copy()
    positions[:, :2] += rng.normal(0.0, SPREAD_M, (n, 2))
    positions[:, 2] = rng.permutation(graph.object_positions[:, 2])
    beside = np.flatnonzero(rng.random(n) < GROUPED)
    positions[beside, :2] = positions[rng.integers(n, size=len(beside)), :2]
    positions[beside, :2] += rng.normal(0.0, GROUP_SPREAD_M, (len(beside), 2))
    parents = nearest_parents(positions, graph.place_positions, np.arange(n))
    return replace(
        graph,
        object_classes=classes,
        object_labels=None,
        object_positions=positions,
        object_parents=parents,
        sightings=none,
    )
