"""The generator: what a building must be whatever its seed."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from semloc_core.errors import ConfigError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.sources.hydra import read_hydra
from semloc_core.sources.world import Furniture, OfficeConfig, RoomKind, World, make_office, write_world
from semloc_core.sources.world.floor_plan import corridor_plan
from semloc_core.sources.world.furniture import furnish
from semloc_core.sources.world.places import sample_places, traversability

TABLE_I = {"chair": 28, "couch": 11, "computer": 35, "plant": 13, "painting": 8, "trash can": 15}

TINY = OfficeConfig(
    rooms=(RoomKind("office", 3, (3.5, 4.5)),),
    furniture=(
        Furniture("computer", 3, "wall", (0.5, 0.4, 0.4), 0.9, rooms=("office",), footprint=(1.4, 0.7)),
        Furniture("chair", 3, "beside", (0.6, 0.6, 0.9), 0.5, beside="computer"),
        Furniture("trash can", 2, "door", (0.3, 0.3, 0.4), 0.2, rooms=("office",)),
    ),
    wings=1,
    depth_m=4.0,
)


@pytest.fixture(scope="module")
def office() -> World:
    return make_office(OfficeConfig(), np.random.default_rng(0))


def arrays_of(world: World) -> GraphArrays:
    return GraphArrays.from_scene_graph(world.graph, world.labelspace)


def test_the_office_has_the_counts_of_table_i(office: World) -> None:
    counts: dict[str, int] = {}
    for thing in office.graph.objects.values():
        counts[thing.class_] = counts.get(thing.class_, 0) + 1
    assert counts == TABLE_I
    assert all(office.labelspace.index(name) >= 0 for name in counts)


@pytest.mark.parametrize("seed", range(4))
def test_the_office_has_about_1300_places_whatever_the_seed(seed: int) -> None:
    world = make_office(OfficeConfig(), np.random.default_rng(seed))
    assert 1170 <= len(world.graph.places) <= 1430


def test_places_lie_as_hydras_do(office: World) -> None:
    arrays = arrays_of(office)
    nearest = cKDTree(arrays.place_positions[:, :2]).query(arrays.place_positions[:, :2], k=2)[0][:, 1]
    assert np.quantile(nearest, 0.02) >= 0.4
    assert np.quantile(nearest, 0.99) <= 0.9
    assert 4.0 < 2 * arrays.place_edges.shape[1] / arrays.n_places < 6.0
    assert 0.05 < arrays.place_positions[:, 2].std() < 0.3


def test_every_place_can_be_reached(office: World) -> None:
    arrays = arrays_of(office)
    a, b = arrays.place_edges
    links = coo_array((np.ones(len(a)), (a, b)), shape=(arrays.n_places, arrays.n_places))
    assert connected_components(links, directed=False)[0] == 1


def test_every_object_has_one_parent_near_by(office: World) -> None:
    arrays = arrays_of(office)
    assert arrays.object_parents[0].tolist() == list(range(arrays.n_objects))
    away = arrays.object_positions[:, :2] - arrays.place_positions[arrays.object_parents[1], :2]
    assert np.linalg.norm(away, axis=1).max() < 2.5


def test_every_place_belongs_to_one_room(office: World) -> None:
    owned = [place for room in office.rooms.values() for place in room.places]
    assert sorted(owned) == sorted(office.graph.places)


def test_same_seed_same_world_another_seed_another() -> None:
    worlds = [make_office(TINY, np.random.default_rng(seed)) for seed in (5, 5, 6)]
    assert worlds[0].graph == worlds[1].graph
    assert worlds[0].rooms == worlds[1].rooms
    assert worlds[0].graph != worlds[2].graph


@pytest.mark.parametrize("seed", range(5))
def test_no_edge_goes_through_a_wall_or_through_furniture(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plan = corridor_plan(TINY.rooms, rng, wings=2, depth_m=4.0, corridor_m=2.0, passages=0.5, passage_m=2.0)
    items = furnish(plan, TINY.furniture, rng)
    points, rooms = sample_places(plan, items, TINY.darts_per_m2, TINY.spacing_m, rng)
    edges = traversability(plan, items, points, rooms, TINY.max_edge_m)
    assert edges.shape[1] > 100
    for a, b in edges.T:
        along = points[a] + np.linspace(0, 1, 41)[:, None] * (points[b] - points[a])
        at_a, at_b = ({r} if r >= 0 else set(plan.doors[-1 - r].rooms) for r in (int(rooms[a]), int(rooms[b])))
        assert at_a & at_b, "the ends share no room"
        room = plan.rooms[min(at_a & at_b)] if rooms[a] != rooms[b] or rooms[a] >= 0 else None
        if room is not None:
            assert (along >= np.array(room.low) - 1e-9).all()
            assert (along <= np.array(room.high) + 1e-9).all()
        for item in items:
            inside = (np.abs(along - item.position[:2]) < np.array(item.half) - 1e-6).all(axis=1)
            assert not inside.any()


def test_furniture_neither_overlaps_nor_leaves_its_room() -> None:
    rng = np.random.default_rng(3)
    config = OfficeConfig()
    plan = corridor_plan(config.rooms, rng, wings=2, depth_m=5.5, corridor_m=2.4, passages=0.5, passage_m=2.5)
    items = furnish(plan, config.furniture, rng)
    for i, item in enumerate(items):
        room = plan.rooms[item.room]
        assert (np.array(item.position[:2]) - item.half >= np.array(room.low) - 1e-6).all()
        assert (np.array(item.position[:2]) + item.half <= np.array(room.high) + 1e-6).all()
        for other in items[:i]:
            gap = np.abs(np.array(item.position[:2]) - other.position[:2]) - item.half - np.array(other.half)
            assert gap.max() > -1e-6, (item, other)


def test_a_written_world_reads_back_the_same(tmp_path: Path) -> None:
    world = make_office(TINY, np.random.default_rng(1))
    write_world(tmp_path / "office.json", world)
    file = read_hydra(tmp_path / "office.json", world.labelspace)
    assert file.dropped == {}
    assert file.graph.places == world.graph.places
    assert file.graph.objects == world.graph.objects
    assert file.graph.neighbours == world.graph.neighbours
    assert file.graph.parents == world.graph.parents
    assert {room.name for room in file.rooms.values()} == {room.name for room in world.rooms.values()}


@pytest.mark.parametrize(
    ("furniture", "message"),
    [
        (
            Furniture("chair", 1, "floor", (0.5, 0.5, 1), 0.5, rooms=("attic",)),
            "expected a room of kind attic",
        ),
        (Furniture("couch", 99, "wall", (2, 1, 1), 0.5, rooms=("office",)), "expected room for 99 of couch"),
        (
            Furniture("chair", 4, "beside", (0.5, 0.5, 1), 0.5, beside="computer"),
            "expected at least 4 of computer",
        ),
    ],
)
def test_furniture_that_does_not_fit_is_an_error(furniture: Furniture, message: str) -> None:
    config = msgspec.structs.replace(TINY, furniture=(TINY.furniture[0], furniture))
    with pytest.raises(ConfigError, match=message + r".*\(got"):
        make_office(config, np.random.default_rng(0))


def test_a_door_as_wide_as_its_room_fits() -> None:
    kinds = (RoomKind("hall", 4, (4.0, 8.0), door_m=20.0),)
    for seed in range(20):
        plan = corridor_plan(
            kinds, np.random.default_rng(seed), wings=1, depth_m=4.0, corridor_m=2.0, passages=1.0, passage_m=20.0
        )
        for door in plan.doors:
            for room in (plan.rooms[i] for i in door.rooms if plan.rooms[i].kind == "hall"):
                assert room.low[door.axis] - 1e-9 <= door.centre[door.axis] - door.width / 2
                assert door.centre[door.axis] + door.width / 2 <= room.high[door.axis] + 1e-9
