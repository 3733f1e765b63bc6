"""The cost of a repair: a move where everything borders on everything must not cost more than starting anew.

What a repair gives is tested with visibility, against balls made from nothing. And many balls without scipy.
"""

import sys
from itertools import combinations

import numpy as np
import pytest

from semloc_core.graph import geodesic


def test_a_move_in_a_dense_graph_puts_little_on_the_heap(monkeypatch):
    """A clique of n places has n²/2 edges; all lie within the ball, and one place's n - 1 change."""
    n = 60
    at = {f"p{i:02d}": tuple(x) for i, x in enumerate(np.random.default_rng(0).uniform(0, 1, (n, 3)).tolist())}

    def clique() -> dict[str, dict[str, float]]:
        rows: dict[str, dict[str, float]] = {place: {} for place in at}
        for a, b in combinations(at, 2):
            rows[a][b] = rows[b][a] = geodesic.edge_length(at[a], at[b])
        return rows

    distances = geodesic.ball(clique(), "p00", 4.0)
    at["p07"] = (0.5, 0.5, 0.5)
    rows, pushed = clique(), []
    heappush = geodesic.heappush
    monkeypatch.setattr(geodesic, "heappush", lambda heap, item: (pushed.append(item), heappush(heap, item)))
    geodesic.repair(distances, rows, "p00", 4.0, at)
    assert len(pushed) < 10 * n
    assert distances == geodesic.ball(rows, "p00", 4.0)


@pytest.mark.parametrize("sources", [0, 1, 40])
def test_many_balls_are_the_same_without_scipy(monkeypatch, sources):
    """A plane of places of which some are not joined at all, with edges of no length and two ways of one length."""
    rng = np.random.default_rng(1)
    at = np.round(rng.uniform(0, 10, (60, 3)) * [1, 1, 0], 1)
    at[1] = at[0]
    pairs = [(a, b) for a, b in combinations(range(50), 2) if np.linalg.norm(at[a] - at[b]) < 2.5]
    edges = np.array(pairs, dtype=np.int64).T
    asked = (60, edges, geodesic.edge_lengths(at, edges), np.arange(sources) * 60 // max(sources, 1))
    found = geodesic.many_balls(*asked, 6.0)
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    for cells in (1 << 23, 64):
        monkeypatch.setattr(geodesic, "_CELLS_AT_ONCE", cells)
        for one, other in zip(found, geodesic.many_balls(*asked, 6.0), strict=True):
            assert one.tolist() == other.tolist()
    if sources == 40:
        assert 0.0 in found[2][found[0] != found[1]]
        assert len(found[2]) < 40 * 60
    lone = geodesic.many_balls(3, np.zeros((2, 0), dtype=np.int64), np.zeros(0), np.array([2]), 1.0)
    assert [part.tolist() for part in lone] == [[0], [2], [0.0]]
