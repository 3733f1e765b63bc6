"""A building small enough to train on in a test."""

import numpy as np
import pytest

from semloc_core.graph.arrays import GraphArrays
from semloc_core.sources.world import Furniture, OfficeConfig, RoomKind, World, make_office

SMALL = OfficeConfig(
    rooms=(RoomKind("office", 2, (3.5, 4.5)), RoomKind("lounge", 1, (4.0, 5.0))),
    furniture=(
        Furniture("computer", 3, "wall", (0.5, 0.4, 0.4), 0.9, rooms=("office",), footprint=(1.4, 0.7)),
        Furniture("couch", 2, "wall", (1.9, 0.9, 0.8), 0.4, rooms=("lounge",)),
        Furniture("plant", 3, "wall", (0.5, 0.5, 1.2), 0.6, rooms=("lounge", "corridor")),
        Furniture("chair", 3, "beside", (0.6, 0.6, 0.9), 0.5, beside="computer"),
    ),
    wings=1,
    depth_m=4.0,
    spacing_m=(0.7, 1.1),
)


@pytest.fixture(scope="session")
def small_worlds() -> list[World]:
    """Three buildings of about 60 places."""
    return [make_office(SMALL, np.random.default_rng(seed)) for seed in range(3)]


@pytest.fixture(scope="session")
def small_arrays(small_worlds: list[World]) -> GraphArrays:
    return GraphArrays.from_scene_graph(small_worlds[0].graph, small_worlds[0].labelspace, "small")
