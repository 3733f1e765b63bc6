"""The cost of a repair: a move where everything borders on everything must not cost more than starting anew.

What a repair gives is tested with visibility, against balls made from nothing.
"""

from itertools import combinations

import numpy as np

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
