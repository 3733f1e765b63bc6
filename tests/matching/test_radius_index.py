"""Near places decide probabilities and rivals: the grid must find exactly what brute force finds."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.matching.radius_index import RadiusIndex


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0.5, 6.0))
def test_equals_brute_force(seed, n, radius):
    rng = np.random.default_rng(seed)
    positions = np.round(rng.uniform(-8, 8, (n, 3)), 1)
    building = rng.integers(0, 2, n).astype(np.int32)
    index = RadiusIndex(positions, building, radius)
    for row in range(n):
        distance = np.linalg.norm(positions - positions[row], axis=1)
        expected = np.flatnonzero((np.round(distance, 9) <= radius) & (building == building[row]))
        exact = np.abs(distance - radius) > 1e-6
        found = index.within(row)
        assert np.array_equal(found[exact[found]], expected[exact[expected]])


def test_places_on_two_floors_are_apart():
    index = RadiusIndex(np.array([[0.0, 0, 0], [0, 0, 5.0]]), np.zeros(2, dtype=np.int32), 4.0)
    assert index.within(0).tolist() == [0]
