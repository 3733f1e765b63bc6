"""The same building with its places sampled anew, as another run would have laid them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semloc_core.graph.arrays import Floats, GraphArrays, Ints

JITTER = 0.15
"""Standard deviation of a new place's x and y, as a share of the places' spacing."""


def place_spacing(graph: GraphArrays) -> float:
    """Median distance from a place to its nearest neighbour, metres; 0 where there are no two places."""
    from scipy.spatial import cKDTree

    if graph.n_places < 2:
        return 0.0
    distance = np.asarray(cKDTree(graph.place_positions).query(graph.place_positions, k=2)[0])
    return float(np.median(distance[:, 1]))


def resample_places(graph: GraphArrays, spacing_m: float, rng: np.random.Generator) -> GraphArrays:
    """Lay the places anew in the same free space.

    What is known to be free is what the traversability edges cross. Points every half spacing along them are thinned
    at random until no two are nearer than the spacing (Poisson disc); two new places are joined where their
    cells touch, a cell being what is nearest along the edges (the dual of the graph Voronoi diagram), so what was
    connected stays so and nothing is joined through a wall. At last each place is moved a little. Objects
    go to the nearest new place; a sighting is had by the new places that are nearest to one that had it.

    Args:
        graph: the building.
        spacing_m: least distance between two new places before they are moved, metres.
        rng: source of randomness.

    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components, dijkstra

    if graph.n_places < 2 or spacing_m <= 0:
        return graph
    points, edges, lengths = _points_along_edges(graph, spacing_m / 2)
    adjacency = coo_matrix((np.maximum(lengths, 1e-9), (edges[0], edges[1])), shape=(len(points), len(points))).tocsr()
    component = connected_components(adjacency, directed=False)[1].astype(np.int64)
    chosen = _thin(points, spacing_m, component, rng)
    _, _, source = dijkstra(adjacency, directed=False, indices=chosen, min_only=True, return_predecessors=True)
    cell = np.searchsorted(chosen, source)
    a, b = cell[edges[0]], cell[edges[1]]
    joined = np.unique(np.stack([np.minimum(a, b), np.maximum(a, b)])[:, a != b], axis=1)
    positions = points[chosen]
    positions[:, :2] += rng.normal(0.0, JITTER * spacing_m, (len(chosen), 2))
    laid = replace(
        graph,
        place_ids=tuple(f"resampled_{i:07d}" for i in range(len(chosen))),
        place_positions=positions,
        place_edges=joined.astype(np.int64),
        object_parents=nearest_parents(graph.object_positions, positions, np.unique(graph.object_parents[0])),
    )
    offsets = np.zeros_like(graph.object_positions)
    return replace(laid, sightings=carried_sightings(graph, positions, offsets))


def nearest_parents(objects: Floats, places: Floats, which: Ints) -> Ints:
    """(2, K) object over its nearest place, for the K objects in ``which``; none where there are no places."""
    from scipy.spatial import cKDTree

    if not len(places) or not len(which):
        return np.zeros((2, 0), dtype=np.int64)
    nearest = cKDTree(places).query(objects[which])[1]
    return np.stack([which, nearest]).astype(np.int64)


def carried_sightings(graph: GraphArrays, places: Floats, offsets: Floats) -> Ints:
    """Explicit sightings after objects moved and places changed.

    A place at x sees an object that moved by d where the old place nearest to x − d saw it.

    Args:
        graph: the building before; O objects.
        places: (P', 3) the places after, metres.
        offsets: (O, 3) by how much each object moved, metres.

    Returns:
        (2, S') new place index over object index, sorted.

    """
    from scipy.spatial import cKDTree

    found: list[Ints] = []
    if graph.sightings.shape[1]:
        old = cKDTree(graph.place_positions)
        for o in np.unique(graph.sightings[1]):
            saw = np.zeros(graph.n_places, dtype=np.bool_)
            saw[graph.sightings[0, graph.sightings[1] == o]] = True
            sees = np.flatnonzero(saw[old.query(places - offsets[o])[1]])
            found.append(np.stack([sees, np.full_like(sees, o)]))
    pairs = np.concatenate(found, axis=1) if found else np.zeros((2, 0), dtype=np.int64)
    return pairs[:, np.lexsort((pairs[1], pairs[0]))].astype(np.int64)


def _points_along_edges(graph: GraphArrays, step_m: float) -> tuple[Floats, Ints, Floats]:
    """The places and points between them: (N, 3) points (places first), (2, E') edges, (E',) lengths."""
    (a, b), lengths = graph.place_edges, graph.edge_lengths()
    pieces = np.maximum(1, np.ceil(lengths / step_m)).astype(np.int64)
    inner = pieces - 1
    first = graph.n_places + np.concatenate([[0], np.cumsum(inner)[:-1]]).astype(np.int64) if len(a) else inner
    edge = np.repeat(np.arange(len(a)), pieces)
    k = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    start = np.where(k == 0, a[edge], first[edge] + k - 1)
    end = np.where(k == inner[edge], b[edge], first[edge] + k)
    between = k < inner[edge]
    share = ((k + 1) / pieces[edge])[between, None]
    origin, target = graph.place_positions[a[edge][between]], graph.place_positions[b[edge][between]]
    points = np.concatenate([graph.place_positions, origin + share * (target - origin)])
    return points, np.stack([start, end]).astype(np.int64), lengths[edge] / pieces[edge]


def _thin(points: Floats, spacing_m: float, component: Ints, rng: np.random.Generator) -> Ints:
    """Indices (ascending) of a random maximal subset no two of which are nearer than the spacing.

    Each connected component keeps a point at least, however near it is to another's.
    """
    from scipy.spatial import cKDTree

    near = cKDTree(points).query_ball_point(points, spacing_m)
    free = np.ones(len(points), dtype=np.bool_)
    chosen = np.zeros(len(points), dtype=np.bool_)
    order = rng.permutation(len(points))
    for i in order:
        if free[i]:
            chosen[i] = True
            free[near[i]] = False
    bare = np.setdiff1d(component, component[chosen])
    first_of = {int(component[i]): int(i) for i in order[::-1]}
    chosen[[first_of[int(c)] for c in bare]] = True
    return np.flatnonzero(chosen)
