"""Another day's view of a building: objects moved, missed, invented or mislabelled, places sampled anew.

Every function takes and returns `GraphArrays` and draws from the generator it is given. Nothing in the result says
which place or object was which, but positions: places are matched by where they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semloc_core.graph import (
    Floats,
    GraphArrays,
    Labelspace,
    carried_sightings,
    nearest_parents,
    place_spacing,
    resample_places,
)
from semloc_core.training.config import PerturbConfig
from semloc_core.training.split import Bools

FALSE_REACH_M = 1.0
"""Standard deviation of x and of y of an invented object around the place it is invented at, metres."""


def perturb(graph: GraphArrays, labelspace: Labelspace, config: PerturbConfig, rng: np.random.Generator) -> GraphArrays:
    """One perturbed variant (paper, section IV-B2, and beyond it what a detector and a second run do).

    Args:
        graph: the building.
        labelspace: its classes and their mobility.
        config: what is done.
        rng: source of randomness; the same state gives the same variant.

    """
    if rng.random() < config.resample_probability:
        factor = rng.uniform(config.spacing_low, max(config.spacing_low, config.spacing_high))
        graph = resample_places(graph, factor * place_spacing(graph), rng)
    if config.edge_drop_probability > 0:
        found = rng.random(graph.place_edges.shape[1]) >= config.edge_drop_probability
        graph = replace(graph, place_edges=graph.place_edges[:, found])
    if config.drop_probability > 0:
        graph = graph.with_objects(rng.random(graph.n_objects) >= config.drop_probability)
    deviation = np.hypot(config.mobility_scale * _mobility(graph, labelspace), config.jitter_m)
    graph = displace_objects(graph, deviation, rng)
    if config.mislabel_probability > 0:
        graph = mislabel_objects(graph, len(labelspace), rng.random(graph.n_objects) < config.mislabel_probability, rng)
    if config.false_ratio > 0:
        graph = add_false_objects(graph, int(rng.poisson(config.false_ratio * graph.n_objects)), rng)
    return graph


def displace_objects(graph: GraphArrays, deviation_m: Floats, rng: np.random.Generator) -> GraphArrays:
    """Move objects horizontally; an object that moved and had a parent gets the nearest place as its one parent.

    Args:
        graph: the building.
        deviation_m: (O,) standard deviation of x and of y, metres; an object with 0 keeps all it has.
        rng: source of randomness.

    """
    offsets = np.zeros_like(graph.object_positions)
    offsets[:, :2] = rng.normal(size=(graph.n_objects, 2)) * deviation_m[:, None]
    moved = deviation_m > 0
    if not moved.any():
        return graph
    positions = graph.object_positions + offsets
    had, kept = graph.object_parents[:, moved[graph.object_parents[0]]], ~moved[graph.object_parents[0]]
    parents = nearest_parents(positions, graph.place_positions, np.unique(had[0]))
    parents = np.concatenate([graph.object_parents[:, kept], parents], axis=1)
    return replace(
        graph,
        object_positions=positions,
        object_parents=parents[:, np.lexsort((parents[1], parents[0]))],
        sightings=carried_sightings(graph, graph.place_positions, offsets),
    )


def mislabel_objects(graph: GraphArrays, n_classes: int, wrong: Bools, rng: np.random.Generator) -> GraphArrays:
    """Give objects another class, drawn from the others by how often the building has them.

    Args:
        graph: the building.
        n_classes: C; where the building has only the object's own class, all others are as likely.
        wrong: (O,) which objects.
        rng: source of randomness.

    """
    classes = graph.object_classes.copy()
    counts = _class_counts(graph, n_classes)
    for o in np.flatnonzero(wrong):
        others = counts.copy()
        if classes[o] >= 0:
            others[classes[o]] = 0
        if not others.any():
            others = np.ones(n_classes)
            others[classes[o] if classes[o] >= 0 else slice(0, 0)] = 0
        if others.any():
            classes[o] = rng.choice(n_classes, p=others / others.sum())
    return replace(graph, object_classes=classes, object_labels=None)


def add_false_objects(graph: GraphArrays, n: int, rng: np.random.Generator) -> GraphArrays:
    """Invent n objects: class by the building's frequencies, position near a random place, which is the parent."""
    present = graph.object_classes[graph.object_classes >= 0]
    if n == 0 or not len(present) or graph.n_places == 0:
        return graph
    place = rng.integers(graph.n_places, size=n)
    positions = graph.place_positions[place]
    positions[:, :2] += rng.normal(0.0, FALSE_REACH_M, (n, 2))
    # Heights are taken from real objects: a place floats in mid-air, a chair does not.
    positions[:, 2] = rng.choice(graph.object_positions[:, 2], n)
    which = graph.n_objects + np.arange(n)
    known = set(graph.object_ids)
    ids = [f"false_{i:06d}" for i in range(n + len(known)) if f"false_{i:06d}" not in known][:n]
    return _sorted_objects(
        replace(
            graph,
            object_ids=graph.object_ids + tuple(ids),
            object_positions=np.concatenate([graph.object_positions, positions]),
            object_classes=np.concatenate([graph.object_classes, rng.choice(present, n)]),
            object_labels=None,
            object_parents=np.concatenate([graph.object_parents, np.stack([which, place])], axis=1),
        )
    )


def _sorted_objects(graph: GraphArrays) -> GraphArrays:
    """The same building with its objects in canonical order (ids sorted as strings)."""
    order = np.array(sorted(range(graph.n_objects), key=graph.object_ids.__getitem__), dtype=np.int64)
    new_index = np.argsort(order)
    parents = np.stack([new_index[graph.object_parents[0]], graph.object_parents[1]])
    sightings = np.stack([graph.sightings[0], new_index[graph.sightings[1]]])
    return replace(
        graph,
        object_ids=tuple(graph.object_ids[i] for i in order),
        object_positions=graph.object_positions[order],
        object_classes=graph.object_classes[order],
        object_parents=parents[:, np.lexsort((parents[1], parents[0]))],
        sightings=sightings[:, np.lexsort((sightings[1], sightings[0]))],
    )


def _mobility(graph: GraphArrays, labelspace: Labelspace) -> Floats:
    by_class = np.array([labelspace.mobility_of(c) for c in labelspace.classes] + [labelspace.default_mobility])
    mobility: Floats = by_class[graph.object_classes]
    return mobility


def _class_counts(graph: GraphArrays, n_classes: int) -> Floats:
    present = graph.object_classes[graph.object_classes >= 0]
    return np.bincount(present, minlength=n_classes).astype(np.float64)
