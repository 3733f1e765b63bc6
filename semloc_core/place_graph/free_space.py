"""How much free space lies how far from a place: what the places themselves say of a spot, whatever stands there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.geodesic import many_balls
from semloc_core.graph_arrays import Floats, GraphArrays
from semloc_core.scene_graph import SceneGraph

Bands = Sequence[tuple[float, float]]
"""Gaussian bands of geodesic distance: centre and standard deviation of each, metres."""


def free_space(distances: Floats, cells: Floats, bands: Bands) -> NDArray[np.float32]:
    """Area (m²) in each band around one place: Σ over places of exp(-½((d - centre)/width)²) · cell.

    A place stands for a cell of the free space; the side of the cell is its distance to the nearest neighbour, so
    that the measure does not depend on how densely places are sampled. The order of the places has no say.

    Args:
        distances: (n,) geodesic distance of each place in reach, metres.
        cells: (n,) area that each stands for, m².
        bands: R bands.

    Returns:
        (R,) float32.

    """
    order = np.lexsort((cells, distances))
    distances, cells = distances[order], cells[order]
    centre, width = np.array(bands, dtype=np.float64).reshape(-1, 2).T
    weight = np.exp(-0.5 * ((distances[:, None] - centre) / width) ** 2)
    area: NDArray[np.float32] = (weight * cells[:, None]).sum(axis=0).astype(np.float32)
    return area


def free_space_online(graph: SceneGraph, places: Sequence[str], radius_m: float, bands: Bands) -> NDArray[np.float32]:
    """(B, R) free space around places of the online graph; places farther than ``radius_m`` do not count."""
    rows = np.zeros((len(places), len(bands)), dtype=np.float32)
    slots = graph.index.slots
    cell_of: dict[str, float] = {}
    for i, root in enumerate(places):
        distances = graph.index.distances(root, radius_m)
        found = [(distances[slot], place) for place, slot in slots.items() if distances[slot] <= radius_m]
        for _, place in found:
            if place not in cell_of:
                cell_of[place] = _cell(graph.neighbours.get(place, {}))
        rows[i] = free_space(
            np.array([distance for distance, _ in found]),
            np.array([cell_of[place] for _, place in found]),
            bands,
        )
    return rows


def free_space_all(arrays: GraphArrays, roots: NDArray[np.int64], radius_m: float, bands: Bands) -> NDArray[np.float32]:
    """(B, R) the same around many places of a building at once, equal to `free_space_online`."""
    lengths = arrays.edge_lengths()
    cells = place_cells(arrays.n_places, arrays.place_edges, lengths)
    by_root, place, distance = many_balls(arrays.n_places, arrays.place_edges, lengths, roots, radius_m)
    starts = np.searchsorted(by_root, np.arange(len(roots) + 1))
    rows = np.zeros((len(roots), len(bands)), dtype=np.float32)
    for i, (start, stop) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        rows[i] = free_space(distance[start:stop], cells[place[start:stop]], bands)
    return rows


def place_cells(n_places: int, edges: NDArray[np.int64], lengths: Floats) -> Floats:
    """(P,) area (m²) that each place stands for, given edges (2, E) of lengths (E,) in metres."""
    side = np.full(n_places, np.inf)
    for end in edges:
        np.minimum.at(side, end, lengths)
    side[np.isinf(side)] = 0.0
    area: Floats = side * side
    return area


def _cell(neighbours: Mapping[str, float]) -> float:
    """Area that a place stands for, from its edges' lengths; 0 for an isolated one."""
    side = min(neighbours.values(), default=0.0)
    return side * side
