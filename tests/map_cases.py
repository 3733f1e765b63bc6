"""Small maps for the tests of the map database."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_database import LoadedMap, MapDatabase
from semloc_core.wire import Object, Place, SceneGraphUpdate

ONE_LINE = r"^(/[^\n]*: )?expected [^\n]* \(got [^\n]*\)$"
LABELS = Labelspace("test", ("chair", "table", "plant"))
Building = tuple[SceneGraph, list[str], NDArray[np.float64], NDArray[np.float32]]


def make_model(seed: int = 0, labels: Labelspace = LABELS) -> Model:
    generator = torch.Generator().manual_seed(seed)
    return Model(build_encoder("paper", {"hidden": 8, "dimension": 6, "heads": 1}, len(labels), generator), labels)


def make_building(model: Model, n_places: int, seed: int = 0) -> Building:
    """A corridor of places with a chair or a table at every other; embeddings at random."""
    rng = np.random.default_rng(seed)
    ids = [str(2**63 + i) for i in range(n_places)]
    graph = SceneGraph()
    graph.apply(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            seq=0,
            full=True,
            places=[Place(id_, (float(i), float(rng.random()), 0.0)) for i, id_ in enumerate(ids)],
            objects=[
                Object(f"o{i}", LABELS.classes[int(rng.integers(2))], (float(i), 1.0, 0.5))
                for i in range(0, n_places, 2)
            ],
            edges=[*pairwise(ids), *((ids[i], f"o{i}") for i in range(0, n_places, 2))],
            query_place=ids[0] if ids else None,
        )
    )
    arrays = GraphArrays.from_scene_graph(graph, LABELS)
    embeddings = rng.standard_normal((n_places, model.encoder.dimension)).astype(np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    return graph, list(arrays.place_ids), arrays.place_positions, embeddings


def make_map(path: Path, model: Model) -> Path:
    """A map of two buildings, at rest."""
    with MapDatabase.create(path, model) as database:
        database.add_building("b", *make_building(model, 12, 1), source="b.json", frame_id="b_map", stamp_ns=-5)
        database.add_building("a", *make_building(model, 7, 2))
    return path


def same(one: LoadedMap, other: LoadedMap) -> bool:
    return (
        one.hash == other.hash
        and one.place_ids == other.place_ids
        and one.buildings == other.buildings
        and np.array_equal(one.positions, other.positions)
        and np.array_equal(one.embeddings, other.embeddings)
    )
