"""The embeddings of a robot's places along a walk, each of what had been seen by then: a walk in one batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding import Bands, Batch, Model, batch_of_arrays, embed_batch, extract_all, free_space, place_cells
from semloc_core.graph import Ints, many_balls
from semloc_core.sources import Walk


def embed_walk(model: Model, walk: Walk) -> NDArray[np.float32]:
    """(T, D) embeddings of the robot's place at each step, as `semloc_core.localiser.Localiser` would have them."""
    extraction = model.encoder.extraction
    if extraction.kind == "reach":
        stars = stars_along(walk, model.encoder.n_classes, extraction.radius_m, extraction.bands)
        return embed_batch(model, stars)
    rows = []
    for step in range(walk.steps):
        part, place = walk.part(step)
        rows.append(embed_batch(model, extract_all(part, model.encoder.n_classes, extraction))[place])
    return np.stack(rows)


def answered(walk: Walk) -> NDArray[np.bool_]:
    """(T,) whether the robot's place has a neighbour; a localiser does not answer for an isolated one."""
    a, b = walk.graph.place_edges
    known = walk.seen_places[:, a] & walk.seen_places[:, b]
    at = (a == walk.places[:, None]) | (b == walk.places[:, None])
    found: NDArray[np.bool_] = (known & at).any(axis=1)
    return found


def stars_along(walk: Walk, n_classes: int, radius_m: float, bands: Bands = ()) -> Batch:
    """The stars (`semloc_core.encoding.place_graph.reach_batch`) of the robot's place at each step, in the graph then.

    Args:
        walk: T steps.
        n_classes: C.
        radius_m: how far to look, metres, inclusive.
        bands: as in `semloc_core.encoding.place_graph.reach_batch`.

    """
    graph = walk.graph
    lengths = graph.edge_lengths()
    rank = np.argsort(np.argsort(np.array(graph.object_ids, dtype=object))) if graph.n_objects else _NONE
    found = [_star(walk, step, lengths, radius_m, rank) for step in range(walk.steps)]
    counts = np.array([len(objects) for objects, _ in found], dtype=np.int64)
    objects = np.concatenate([o for o, _ in found])
    metres = np.concatenate([d for _, d in found])
    t, m = walk.steps, len(objects)
    root = np.repeat(np.arange(t), counts)
    batch = batch_of_arrays(
        classes=np.concatenate([np.full(t, -1, dtype=np.int64), graph.object_classes[objects]]),
        n_classes=n_classes,
        is_object=np.arange(t + m) >= t,
        edges=np.stack([np.arange(t, t + m), root]),
        lengths=metres,
        graph=np.concatenate([np.arange(t), root]),
        nodes_within=[t, t + m],
        edges_within=[m],
        node_ids=[graph.place_ids[i] for i in walk.places.tolist()] + [graph.object_ids[i] for i in objects.tolist()],
    )
    if bands:
        space = np.stack([_space(walk, step, lengths, radius_m, bands) for step in range(t)])
        batch = replace(batch, free_space=torch.from_numpy(space))
    return batch


_NONE = np.zeros(0, dtype=np.int64)


def _star(
    walk: Walk, step: int, lengths: NDArray[np.float64], radius_m: float, rank: Ints
) -> tuple[Ints, NDArray[np.float64]]:
    """Objects in reach at a step, by id, and metres to the nearest parent of each."""
    graph, places, objects = walk.graph, walk.seen_places[step], walk.seen_objects[step]
    at, far = _reached(walk, step, lengths, radius_m)
    metres = np.full(graph.n_places, np.inf)
    metres[at] = far
    child, parent = graph.object_parents
    linked = objects[child] & places[parent] & (graph.object_classes[child] >= 0)
    nearest = np.full(graph.n_objects, np.inf)
    np.minimum.at(nearest, child[linked], metres[parent[linked]])
    reached = np.flatnonzero(nearest <= radius_m)
    reached = reached[np.argsort(rank[reached])]
    return reached, nearest[reached]


def _reached(walk: Walk, step: int, lengths: NDArray[np.float64], radius_m: float) -> tuple[Ints, NDArray[np.float64]]:
    """Known places in reach of the robot's place at a step, and metres to each."""
    edges, places = walk.graph.place_edges, walk.seen_places[step]
    known = places[edges].all(axis=0)
    here = walk.places[step : step + 1]
    return many_balls(walk.graph.n_places, edges[:, known], lengths[known], here, radius_m)[1:]


def _space(walk: Walk, step: int, lengths: NDArray[np.float64], radius_m: float, bands: Bands) -> NDArray[np.float32]:
    """(R,) known free space around the robot's place at a step."""
    edges, places = walk.graph.place_edges, walk.seen_places[step]
    known = places[edges].all(axis=0)
    cells = place_cells(walk.graph.n_places, edges[:, known], lengths[known])
    at, metres = _reached(walk, step, lengths, radius_m)
    return free_space(metres, cells[at], bands)
