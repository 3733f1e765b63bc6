"""Kinds of buildings: what general encoders learn from must be varied, in the labelspace, and the same each time."""

import msgspec
import numpy as np
import pytest

from semloc_core.errors import ConfigError
from semloc_core.graph.labels.files import load_labelspace
from semloc_core.sources.world import KINDS, Furniture, RoomKind, SecondRun, draw_pair, kinds
from semloc_core.sources.world.floor_plan import corridor_plan
from semloc_core.sources.world.furniture import furnish
from semloc_core.sources.world.kinds import BuildingKind, Rooms, Thing, draw_config
from semloc_core.sources.world.second_run import detect


@pytest.mark.parametrize("name", sorted(KINDS))
def test_a_building_of_every_kind_is_mapped_and_seen_again_elsewhere(name) -> None:
    kind = KINDS[name]
    mapped, seen = draw_pair(kind, np.random.default_rng([3, 1]))
    space = load_labelspace(kind.labelspace)
    for world in (mapped, seen):
        assert len(world.graph.places) > 30
        assert all(space.index(thing.class_) >= 0 for thing in world.graph.objects.values())
    places = set(mapped.graph.places.values())
    assert not places & set(seen.graph.places.values()), "a second run has places of its own"
    again, _ = draw_pair(kind, np.random.default_rng([3, 1]))
    assert again.graph.places == mapped.graph.places
    assert again.graph.objects == mapped.graph.objects


def test_no_two_buildings_of_a_kind_are_alike() -> None:
    drawn = [draw_config(KINDS["home"], np.random.default_rng(seed)) for seed in range(6)]
    assert len({msgspec.json.encode(config) for config in drawn}) == 6
    assert len({sum(room.count for room in config.rooms) for config in drawn}) > 2


def test_a_detector_misses_moves_and_invents_as_told() -> None:
    rng = np.random.default_rng(0)
    plan = corridor_plan((RoomKind("hall", 2, (30.0, 40.0)),), rng, wings=1, depth_m=20.0, corridor_m=3.0, passages=0.0,
                         passage_m=2.0)  # fmt: skip
    items = furnish(plan, (Furniture("chair", 300, "floor", (0.2, 0.2, 0.2), 0.4, rooms=("hall",)),), rng)
    assert detect(plan, items, SecondRun(missed=0.0, noise_m=0.0, invented=0.0), rng) == items
    assert detect(plan, items, SecondRun(missed=1.0, invented=0.0), rng) == []
    seen = detect(plan, items, SecondRun(missed=0.25, noise_m=0.0, invented=0.15), rng)
    true = [item for item in seen if item in items]
    assert 200 <= len(true) <= 250
    assert 25 <= len(seen) - len(true) <= 65


def test_a_kind_that_can_not_be_furnished_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(kinds, "ATTEMPTS", 2)
    kind = BuildingKind(
        labelspace="coco",
        rooms=(Rooms(RoomKind("cell", 0, (2.0, 2.1)), (1, 1)),),
        things=(Thing(Furniture("bed", 0, "wall", (9.0, 9.0, 1.0), 0.4, rooms=("cell",)), 1.0, usual=True),),
        depth_m=(2.0, 2.1),
        corridor_m=(1.0, 1.1),
        wings=(1, 1),
        passages=(0.0, 0.1),
        clutter=0.0,
    )
    with pytest.raises(ConfigError, match="can be furnished"):
        draw_pair(kind, np.random.default_rng(0))
