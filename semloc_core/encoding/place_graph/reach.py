"""Stars: a place, and an edge to it from every object that is in reach, as long as the way there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.place_graph.batch import Batch, batch_of_arrays
from semloc_core.encoding.place_graph.free_space import Bands, free_space_all, free_space_online
from semloc_core.errors import GraphError
from semloc_core.graph import GraphArrays, Labelspace, SceneGraph, object_distances, ranges


def reach_batch(
    graph: SceneGraph, labelspace: Labelspace, places: Sequence[str], radius_m: float, bands: Bands = ()
) -> Batch:
    """Stars of places of the online graph.

    An object is in reach if one of its parent places is, along traversability edges; the nearest gives the edge
    its length. Explicit sightings have no say. Objects of a class that the labelspace lacks are left out. The
    others are sorted by graph, then id.

    Args:
        graph: the scene graph.
        labelspace: gives objects their class index.
        places: B root places; the same one may come twice.
        radius_m: how far to look, metres, inclusive.
        bands: distance bands in which the free space around the roots is measured; none: it is not.

    Raises:
        GraphError: a root is not a place of the graph.

    """
    if strangers := [place for place in places if place not in graph.places]:
        raise GraphError(f"expected a place of the graph (got {strangers[0]!r})")
    nodes: list[str] = []
    lengths: list[float] = []
    counts: list[int] = []
    for root in places:
        star = _objects_in_reach(graph, labelspace, root, radius_m)
        found = sorted(star)
        nodes += found
        lengths += [star[node] for node in found]
        counts.append(len(found))
    classes = [labelspace.index(graph.objects[node].class_) for node in nodes]
    return _stars(
        np.array(classes, dtype=np.int64),
        len(labelspace),
        np.array(lengths, dtype=np.float64),
        np.array(counts, dtype=np.int64),
        [*places, *nodes],
        free_space_online(graph, places, radius_m, bands) if bands else None,
    )


def reach_all_batch(
    arrays: GraphArrays,
    n_classes: int,
    radius_m: float,
    roots: NDArray[np.int64] | None = None,
    bands: Bands = (),
) -> Batch:
    """Stars of many places of a building at once; the same as `reach_batch` gives.

    Args:
        arrays: the building.
        n_classes: C of the labelspace that ``arrays`` was made with.
        radius_m: how far to look, metres, inclusive.
        roots: (B,) place indices; None takes all places in order.
        bands: as in `reach_batch`.

    """
    objects, places, distances = object_distances(arrays, radius_m)
    known = arrays.object_classes[objects] >= 0
    objects, places, distances = objects[known], places[known], distances[known]
    rank = np.empty(arrays.n_objects, dtype=np.int64)
    rank[sorted(range(arrays.n_objects), key=arrays.object_ids.__getitem__)] = np.arange(arrays.n_objects)
    order = np.argsort(places * arrays.n_objects + rank[objects])
    objects, distances = objects[order], distances[order]
    size = np.bincount(places, minlength=arrays.n_places)
    chosen = np.arange(arrays.n_places) if roots is None else np.asarray(roots, dtype=np.int64)
    row = ranges((np.cumsum(size) - size)[chosen], size[chosen])
    return _stars(
        arrays.object_classes[objects[row]],
        n_classes,
        distances[row],
        size[chosen],
        [arrays.place_ids[i] for i in chosen.tolist()] + [arrays.object_ids[i] for i in objects[row].tolist()],
        free_space_all(arrays, chosen, radius_m, bands) if bands else None,
    )


def take_stars(batch: Batch, roots: NDArray[np.int64]) -> Batch:
    """Some of the stars of a batch of stars, in the order of ``roots`` (B',): rows of its roots."""
    b = batch.n_roots
    owner = batch.edge_index[1].numpy()
    size = np.bincount(owner, minlength=b)
    row = torch.from_numpy(b + ranges((np.cumsum(size) - size)[roots], size[roots]))
    chosen = torch.from_numpy(roots)
    nodes = torch.cat([chosen, row])
    of_root = torch.from_numpy(np.repeat(np.arange(len(roots)), size[roots]))
    first = len(roots)
    return Batch(
        features=batch.features[nodes],
        edge_index=torch.stack([torch.arange(first, first + len(row)), of_root]),
        edge_length=batch.edge_length[row - b],
        is_object=batch.is_object[nodes],
        graph=torch.cat([torch.arange(first), of_root]),
        n_roots=first,
        nodes_within=(first, first + len(row)),
        edges_within=(len(row),),
        node_ids=tuple(batch.node_ids[i] for i in nodes.tolist()),
        free_space=None if batch.free_space is None else batch.free_space[chosen],
    )


def _objects_in_reach(graph: SceneGraph, labelspace: Labelspace, root: str, radius_m: float) -> dict[str, float]:
    distances = graph.index.distances(root, radius_m).tolist()
    slots = graph.index.slots
    star: dict[str, float] = {}
    for place, children in graph.children.items():
        distance = distances[slots[place]]
        if distance <= radius_m:
            for child in children:
                if distance < star.get(child, math.inf) and labelspace.index(graph.objects[child].class_) >= 0:
                    star[child] = distance
    return star


def _stars(
    classes: NDArray[np.int64],
    n_classes: int,
    lengths: NDArray[np.float64],
    counts: NDArray[np.int64],
    node_ids: list[str],
    space: NDArray[np.float32] | None,
) -> Batch:
    """Batch of B stars from their M objects' classes and distances, and how many (B,) each star has."""
    b, m = len(counts), len(classes)
    root = np.repeat(np.arange(b), counts)
    batch = batch_of_arrays(
        classes=np.concatenate([np.full(b, -1, dtype=np.int64), classes]),
        n_classes=n_classes,
        is_object=np.arange(b + m) >= b,
        edges=np.stack([np.arange(b, b + m), root]),
        lengths=lengths,
        graph=np.concatenate([np.arange(b), root]),
        nodes_within=[b, b + m],
        edges_within=[m],
        node_ids=node_ids,
    )
    return batch if space is None else replace(batch, free_space=torch.from_numpy(space))
