"""How much free space lies how far from a place: what the places themselves say of a spot, whatever stands there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, GraphArrays, SceneGraph, many_balls

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
    cells = np.array(graph.index.cells)
    for i, root in enumerate(places):
        distances = graph.index.distances(root, radius_m)
        near = distances <= radius_m  # slots that no place has are never reached
        rows[i] = free_space(distances[near], cells[near], bands)
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
