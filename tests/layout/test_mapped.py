"""The map laid out for verification, against brute force."""

import numpy as np
import pytest

from semloc_core.layout import LayoutConfig, MappedLayout
from semloc_core.layout.mapped import ROOM_CELL_M, pairs_within, room_of

CONFIG = LayoutConfig()


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_those_of_a_comparison_of_all_with_all(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-20, 20, (60, 3)), rng.uniform(-20, 20, (80, 3))
    off = a[:, None] - b[None]
    near = (off[..., 0] ** 2 + off[..., 1] ** 2 <= 36.0) & (np.abs(off[..., 2]) <= 3.0)
    i, j = pairs_within(a, b, 6.0, 3.0)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == list(
        zip(*(x.tolist() for x in np.nonzero(near)), strict=True)
    )


def test_no_pairs_of_nothing():
    nothing = np.zeros((0, 3))
    for a, b in ((nothing, nothing), (np.zeros((1, 3)), nothing), (nothing, np.zeros((1, 3)))):
        assert [len(x) for x in pairs_within(a, b, 1.0, 1.0)] == [0, 0]


def test_room_costs_nothing_where_the_map_has_it_and_most_far_away(homes):
    places = homes[0][0].place_positions
    room = room_of(places, CONFIG)
    assert room is not None
    assert (room.at(places) == 0).all()
    assert (room.at(places + np.array([1000.0, 0, 0])) == np.float32(room.outside)).all()
    rng = np.random.default_rng(0)
    low, high = places.min(axis=0), places.max(axis=0)
    points = np.stack([*rng.uniform(low[:2] - 5, high[:2] + 5, (500, 2)).T, np.full(500, places[0, 2])], axis=1)
    metres = np.linalg.norm(points[:, None, :2] - places[None, :, :2], axis=2).min(axis=1)
    cost = room.at(points)
    # Distances between cells differ from those between points by less than a cell's diagonal.
    assert (cost[metres < CONFIG.room_within_m - 1.5 * ROOM_CELL_M] == 0).all()
    assert (cost[metres > CONFIG.room_within_m + 1.5 * ROOM_CELL_M] > 0).all()


def test_absurd_coordinates_do_not_fill_the_memory():
    assert room_of(np.array([[0.0, 0, 0], [1e9, 1e9, 0]]), CONFIG) is None


def test_objects_near_a_place_are_found_and_unknown_classes_are_not(homes):
    maps, _, space = homes
    layout = MappedLayout(maps, [np.arange(g.n_places) for g in maps], len(space), CONFIG)
    start, found = layout.objects_near
    assert len(start) == layout.n_places + 1
    row = maps[0].n_places + 3  # in the second building
    mine = found[start[row] : start[row + 1]]
    off = maps[1].object_positions - layout.positions[row]
    expected = np.flatnonzero(np.hypot(off[:, 0], off[:, 1]) <= CONFIG.reach_m)
    assert set(expected.tolist()) <= set((mine - maps[0].n_objects).tolist())
    assert (layout.invented > 0).all()
    assert layout.invented.sum() == pytest.approx(CONFIG.invented)
