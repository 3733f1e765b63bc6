import numpy as np
import pytest

from semloc_core.errors import SemlocError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.training.split import PARTS, positive_pairs, split_places

NO_PAIRS = np.zeros((2, 0), dtype=np.int64)


def places(n: int) -> GraphArrays:
    positions = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], 1).astype(np.float64)
    ids = tuple(f"{i:05d}" for i in range(n))
    return GraphArrays("n", ids, positions, NO_PAIRS, (), np.zeros((0, 3)), np.zeros(0, np.int64), NO_PAIRS, NO_PAIRS)


def test_parts_are_70_20_10_and_cover_every_place_once():
    split = split_places(places(1000), seed=1)
    assert [int(split.mask(part).sum()) for part in PARTS] == [700, 200, 100]


def test_seed_decides():
    one, same, other = (split_places(places(100), seed=s).part for s in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_shared_places_keep_their_part_and_new_ones_take_the_nearest():
    graph = places(50)
    split = split_places(graph, seed=0)
    assert np.array_equal(split.parts_of(graph), split.part)
    moved = places(50)
    moved.place_positions[:, 0] += 0.3
    assert np.array_equal(split.parts_of(moved), split.part)


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_places_are_refused_in_one_line(n):
    with pytest.raises(SemlocError, match=rf"expected a graph of at least 2 places to split \(got {n} in n\)"):
        split_places(places(n), seed=0)


def test_positive_pairs_are_within_the_radius_in_three_dimensions():
    query = np.zeros((1, 3))
    reference = np.array([[4.0, 0, 0], [0, 4.01, 0], [3, 0, 3]])
    assert positive_pairs(query, reference, 4.0).tolist() == [[True, False, False]]
