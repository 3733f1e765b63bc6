"""A small building for the training tests: a corridor with rooms off it, objects in the rooms."""

import numpy as np

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace

LABELS = Labelspace("t", ("desk", "chair", "plant"), default_mobility=0.2)


def building(seed: int = 0, n_places: int = 80, n_objects: int = 30, name: str = "b") -> GraphArrays:
    """Places 0.7 m apart along a corridor that winds; objects of three classes at random places."""
    rng = np.random.default_rng(seed)
    row, column = np.divmod(np.arange(n_places), 20)
    x = np.where(row % 2 == 0, column, 19 - column)
    places = np.stack([0.7 * x, 3.0 * row, np.zeros(n_places)], 1)
    parents = rng.integers(n_places, size=n_objects) if n_places else np.zeros(0, dtype=np.int64)
    count = len(parents)
    edges = np.stack([np.arange(n_places - 1), np.arange(1, n_places)]) if n_places > 1 else np.zeros((2, 0))
    return GraphArrays(
        name=name,
        place_ids=tuple(f"p{i:04d}" for i in range(n_places)),
        place_positions=places.astype(np.float64),
        place_edges=edges.astype(np.int64),
        object_ids=tuple(f"o{i:04d}" for i in range(count)),
        object_positions=places[parents] + np.array([0.0, 0.3, 0.0]),
        object_classes=rng.integers(3, size=count),
        object_parents=np.stack([np.arange(count), parents]).astype(np.int64),
        sightings=np.zeros((2, 0), dtype=np.int64),
    )
