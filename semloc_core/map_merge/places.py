"""Places of a traversal and places of the map: which are one, which are new, and what joins the new ones to the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, GraphArrays, Ints, place_spacing
from semloc_core.text import short_repr

APART = 1.5
"""A place is new where the map has none within so many spacings."""


@short_repr
@dataclass(frozen=True, eq=False)
class PlaceMatch:
    """How the P' places of a traversal lie on the P of the map.

    Args:
        of_map: (P',) the map's place that each is one with, -1 for new ones.
        new: (N,) the new ones, ascending.
        links: (2, L) a new place over the map's place that an edge joins it to.
        covered: (P,) whether the traversal saw the map's place as free space, and the places around it.

    """

    of_map: Ints
    new: Ints
    links: Ints
    covered: NDArray[np.bool_]


def match_places(mapped: GraphArrays, seen: GraphArrays, positions: Floats) -> PlaceMatch:
    """Match places by where they are, neighbours by neighbours.

    A place near a wall may be nearer to a place beyond it: of those near enough, the one is taken that lies among
    what the place's neighbours match.

    Args:
        mapped: the building.
        seen: the traversal.
        positions: (P', 3) its places in the building's frame, metres.

    """
    apart = APART * max(place_spacing(mapped), place_spacing(seen))
    near = _within(mapped.place_positions, positions, apart)
    nearest = np.array([some[0] if some else -1 for some in near], dtype=np.int64)
    around, beside = _neighbours(mapped), _neighbours(seen)
    of_map = nearest.copy()
    for place, some in enumerate(near):
        matched = [int(nearest[other]) for other in beside[place] if nearest[other] >= 0]
        votes = [sum(one == other or one in around[other] for one in matched) for other in some]
        if votes:
            of_map[place] = some[votes.index(max(votes))]
    new = np.flatnonzero(of_map < 0)
    links = {(a, int(of_map[b])) for a in new.tolist() for b in beside[a] if of_map[b] >= 0}
    met = np.array([bool(some) for some in _within(positions, mapped.place_positions, apart)], dtype=np.bool_)
    covered = np.array([met[i] and all(met[list(row)]) for i, row in enumerate(around)], dtype=np.bool_)
    return PlaceMatch(of_map, new, np.array(sorted(links), dtype=np.int64).reshape(-1, 2).T, covered)


def _within(points: Floats, of: Floats, metres: float) -> list[list[int]]:
    """For each of ``of`` the points within so many metres, nearest first."""
    from scipy.spatial import cKDTree

    found: list[list[int]] = []
    tree = cKDTree(points)
    for at in of:
        some = np.array(sorted(tree.query_ball_point(at, metres)), dtype=np.int64)
        away = np.linalg.norm(points[some] - at, axis=1)
        found.append(some[np.argsort(away, kind="stable")].tolist())
    return found


def _neighbours(graph: GraphArrays) -> list[set[int]]:
    rows: list[set[int]] = [set() for _ in range(graph.n_places)]
    for a, b in graph.place_edges.T.tolist():
        rows[a].add(b)
        rows[b].add(a)
    return rows
