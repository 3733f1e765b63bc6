"""The map laid out for verification, against brute force."""

import dataclasses

import numpy as np
import pytest

from semloc_core.matching.layout import LayoutConfig, LayoutPart, LayoutVerifier, MappedLayout, fragment_of_arrays
from semloc_core.matching.layout.building import near_pairs as nearby
from semloc_core.matching.layout.building.free_space_cost import FAR_M, ROOM_CELL_M, Rooms, room_of
from semloc_core.matching.layout.building.near_pairs import Nearby

CONFIG = LayoutConfig()


def pairs_within(a, b, reach_m, floor_m):
    """All blocks in one; each is checked to be of the rows that it says."""
    found, done = [], 0
    for first, last, i, j, metres in Nearby(a, b, reach_m, floor_m).blocks():
        assert first == done
        done = last
        assert ((first <= i) & (i < last)).all()
        assert (np.diff(i) >= 0).all()
        np.testing.assert_allclose(metres, np.hypot(*(a[i] - b[j])[:, :2].T))
        found.append(np.stack([i, j]))
    assert done == len(a)
    i, j = np.concatenate([np.zeros((2, 0), np.int64), *found], axis=1)
    order = np.lexsort((j, i))
    return i[order], j[order]


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_those_of_a_comparison_of_all_with_all(seed, monkeypatch):
    if seed:  # blocks of a few rows, and of one
        monkeypatch.setattr(nearby, "_BLOCK_PAIRS", (200, 1)[seed - 1])
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
    rooms = Rooms([room_of(places, CONFIG)])

    def cost(points):
        n = len(points)
        return rooms.lost(np.zeros(n, dtype=np.int64), np.ones(n, dtype=np.complex128), points, np.zeros((1, 3)))

    assert (cost(places) == 0).all()
    furthest = cost(places + np.array([1000.0, 0, 0]))
    assert (furthest == furthest[0]).all()
    rng = np.random.default_rng(0)
    low, high = places.min(axis=0), places.max(axis=0)
    points = np.stack([*rng.uniform(low[:2] - 5, high[:2] + 5, (500, 2)).T, np.full(500, places[0, 2])], axis=1)
    metres = np.linalg.norm(points[:, None, :2] - places[None, :, :2], axis=2).min(axis=1)
    lost = cost(points)
    # Distances between cells differ from those between points by less than a cell's diagonal.
    assert (lost[metres < CONFIG.room_within_m - 1.5 * ROOM_CELL_M] == 0).all()
    assert (lost[metres > CONFIG.room_within_m + 1.5 * ROOM_CELL_M] > 0).all()
    assert (lost[metres > FAR_M + 1.5 * ROOM_CELL_M] == furthest[0]).all()


def test_what_lies_beyond_the_rim_is_as_far_as_can_be_on_every_side():
    """A rounding at the lowest place of a building must not write free space to the other side."""
    for corner in ([-1.83096345, -1.56050512, -1.62744], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]):
        places = np.array(corner) + np.array([[0.0, 0, 0], [10.5, 7.9, 2.6]])
        room = room_of(places, CONFIG)
        for axis in range(3):
            for side in (0, -1):
                assert (np.moveaxis(room.cost, axis, 0)[side] == room.cost.max()).all()
        assert room.cost.min() == 0


def test_several_buildings_have_each_their_own_room(homes):
    rooms = [room_of(graph.place_positions, CONFIG) for graph in homes[0]]
    together = Rooms([rooms[0], None, rooms[1]])
    points = homes[0][1].place_positions
    ahead = np.ones(3, dtype=np.complex128)
    lost = together.lost(np.array([0, 1, 2]), ahead, np.zeros((3, 3)), points)
    assert lost[1:].tolist() == [0, 0]
    assert lost[0] == Rooms(rooms).lost(np.zeros(1, dtype=np.int64), ahead[:1], np.zeros((1, 3)), points)[0]


def test_absurd_coordinates_do_not_fill_the_memory():
    for far in (2e3, 1e9):
        assert room_of(np.array([[0.0, 0, 0], [far, far, 0]]), CONFIG) is None


def test_ten_thousand_objects_at_one_point_count_as_many_as_a_place_has_at_most(homes):
    graph = homes[0][0]
    crowd, rng = 10_000, np.random.default_rng(0)
    at = graph.place_positions[0]
    crowded = dataclasses.replace(
        graph,
        object_ids=tuple(f"{n:05}" for n in range(crowd)),
        object_positions=at + rng.uniform(-0.5, 0.5, (crowd, 3)),
        object_classes=np.zeros(crowd, dtype=np.int64),
        object_parents=np.zeros((2, 0), dtype=np.int64),
        sightings=np.zeros((2, 0), dtype=np.int64),
    )
    verifier = LayoutVerifier([crowded], [np.arange(graph.n_places)], len(homes[2]))
    start, found = verifier.mapped.around.start, verifier.mapped.around.objects
    assert np.diff(start).max() == nearby.MOST_NEAR
    around = verifier.mapped.object_positions[found[: start[1]]] - at
    metres = np.linalg.norm(verifier.mapped.object_positions[:, :2] - at[:2], axis=1)
    assert np.hypot(*around[:, :2].T).max() <= np.sort(np.round(metres, 6))[nearby.MOST_NEAR - 1] + 1e-6
    answer = verifier.verify(fragment_of_arrays(crowded, 0, CONFIG))
    assert answer is not None
    assert np.isfinite(answer.score).all()


def test_objects_near_a_place_are_found_and_unknown_classes_are_not(homes):
    maps, _, space = homes
    layout = MappedLayout([LayoutPart(g, np.arange(g.n_places), len(space)) for g in maps], len(space), CONFIG)
    start, found = layout.around.start, layout.around.objects
    assert len(start) == layout.n_places + 1
    row = maps[0].n_places + 3  # in the second building
    mine = found[start[row] : start[row + 1]]
    off = maps[1].object_positions - layout.positions[row]
    expected = np.flatnonzero(np.hypot(off[:, 0], off[:, 1]) <= CONFIG.reach_m)
    assert set(expected.tolist()) <= set((mine - maps[0].n_objects).tolist())
    assert (layout.invented > 0).all()
    assert layout.invented.sum() == pytest.approx(CONFIG.invented)
