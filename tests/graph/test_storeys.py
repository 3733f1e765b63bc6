"""Storeys: told by floors, not by the heights of places, on generated buildings and on real ones."""

import os
from pathlib import Path

import numpy as np
import pytest

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.storeys import separate, storey_at, storeys, storeys_at
from semloc_core.sources.hydra import read_hydra
from semloc_core.sources.world import KINDS, draw_stacked

DATA = Path(os.environ.get("SEMLOC_DATA", Path(__file__).parents[2] / "shared" / "data"))


def floor(height: float, spread: float, seed: int, side: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """A floor's places, floating by up to ``spread``, and edges between those beside one another."""
    x, y = (axis.ravel() * 0.8 for axis in np.meshgrid(np.arange(side), np.arange(side)))
    positions = np.stack([x, y, height + spread * (0.5 + 0.5 * np.sin(x / 2 + seed) * np.cos(y / 2))], axis=1)
    edges = [(i, j) for i in range(len(x)) for j in (i + 1, i + side) if j < len(x) and abs(x[i] - x[j]) < 1.0]
    return positions, np.array(edges, dtype=np.int64).T


def stairs(low: np.ndarray, high: np.ndarray, first: int, foot: int, head: int) -> tuple[np.ndarray, np.ndarray]:
    """A flight of six places between two places."""
    way = low + (high - low) * np.linspace(0.0, 1.0, 8)[1:-1, None]
    chain = [foot, *range(first, first + len(way)), head]
    return way, np.sort(np.array([chain[:-1], chain[1:]], dtype=np.int64), axis=0)


@pytest.mark.parametrize("spread", [0.0, 1.0, 2.6])
def test_floors_joined_by_stairs_are_storeys_however_their_places_float(spread):
    (one, its), (other, own) = floor(0.1, spread, 1), floor(3.0, spread, 2)
    n = len(one)
    way, steps = stairs(one[0], other[3], 2 * n, 0, n + 3)
    found = storeys(np.concatenate([one, other, way]), np.concatenate([its, own + n, steps], axis=1))
    assert set(found.tolist()) == {0, 1}
    assert (found[:n] != 0).sum() <= 0.02 * n
    assert (found[n : 2 * n] != 1).sum() <= 0.02 * n


def test_a_few_steps_up_and_a_high_hall_are_one_storey():
    (one, its), (other, own) = floor(0.5, 0.1, 1), floor(1.2, 0.1, 2)
    n = len(one)
    beside = np.array([[13 + 14 * i, n + 14 * i] for i in range(14)], dtype=np.int64).T
    edges = np.concatenate([its, own + n, beside], axis=1)
    assert not storeys(np.concatenate([one, other + np.array([11.2, 0, 0])]), edges).any(), "0.7 m up"
    (hall, own), slope = floor(0.0, 0.1, 3), np.linspace(0.0, 2.5, 14)
    hall[:, 2] += np.tile(slope, 14) + 0.5
    edges = np.concatenate([its, own + n, beside], axis=1)
    assert not storeys(np.concatenate([one, hall + np.array([11.2, 0, 0])]), edges).any(), (
        "places in the middle of its height"
    )


def test_a_building_of_few_places_or_none_is_one_storey():
    assert storeys(np.zeros((0, 3)), np.zeros((2, 0), dtype=np.int64)).tolist() == []
    assert not storeys(np.array([[0.0, 0, 0], [0, 0, 3]]), np.zeros((2, 0), dtype=np.int64)).any()


def test_a_generated_tower_has_its_storeys():
    world, again = draw_stacked(KINDS["home"], 3, np.random.default_rng(3), alike=True)
    for run in (world, again):
        found = GraphArrays.from_scene_graph(run.graph, run.labelspace).storeys
        assert set(found.tolist()) == {0, 1, 2}


def test_a_point_is_on_the_storey_whose_places_span_its_height():
    positions = np.array([[0, 0, 0.2], [1, 0, 2.7], [0, 1, 3.2], [1, 1, 5.6], [30, 0, 3.3]], dtype=np.float64)
    storey = np.array([0, 0, 1, 1, 1])
    for height, on in ((0.0, 0), (2.6, 0), (3.0, 1), (4.4, 1), (6.0, 1)):
        assert storey_at(np.array([0.5, 0.5, height]), positions, storey) == on, height
    assert separate(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])).tolist() == [0, 1, 2, 3]


def test_storeys_of_many_buildings_are_numbered_in_order_whatever_they_are_called():
    rng = np.random.default_rng(0)
    building = np.sort(rng.integers(0, 9, 200)).astype(np.int32)
    for storey in (rng.integers(-2, 3, 200), rng.choice([-(2**60), 0, 7, 2**60], 200)):
        pairs = sorted(set(zip(building.tolist(), storey.tolist(), strict=True)))
        wanted = [pairs.index(pair) for pair in zip(building.tolist(), storey.tolist(), strict=True)]
        assert separate(building, storey).tolist() == wanted
    assert separate(building[:0], storey[:0]).tolist() == []


def test_a_point_between_floors_is_on_either_and_one_on_a_floor_on_that_alone():
    positions = np.array([[x, y, z] for z in (0.5, 3.2) for x in range(6) for y in range(6)], dtype=np.float64)
    storey = np.repeat([0, 1], 36)
    for height, on in ((0.0, [0]), (0.9, [0]), (1.3, [0, 1]), (1.6, [1, 0]), (2.0, [1, 0]), (2.6, [1]), (3.4, [1])):
        point = np.array([2.5, 2.5, height])
        assert storeys_at(point, positions, storey) == on, height
        assert storey_at(point, positions, storey) == on[0]


@pytest.mark.parametrize(
    ("file", "levels"),
    [
        ("goseek/office.json", 1),  # z from 0.08 to 2.97 on one floor
        ("hydra/apartment_short.json", 1),
        ("hydra/mp3d_partial_600.json", 1),
        ("gibson/Allensville/map.json", 1),
        ("gibson/Benevolence/map.json", 3),
        ("gibson/Forkland/map.json", 3),
        ("gibson/Wainscott/map.json", 2),  # levels of 0.3 m more or less on one floor
    ],
)
def test_storeys_of_real_buildings(file, levels):
    path = DATA / file
    if not path.exists():
        pytest.skip(f"{path} is not there: see shared/data/README.md")
    read = read_hydra(path)
    found = GraphArrays.from_scene_graph(read.graph, read.labelspace).storeys
    assert found.max() + 1 == levels
