"""A small building for tests: a corridor of places with objects along it, and the map made of it."""

from pathlib import Path

import numpy as np

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_database import LoadedMap, MapDatabase, load
from semloc_core.wire import Object, Place, SceneGraphUpdate

CLASSES = ("chair", "couch", "plant", "painting")
SPACE = Labelspace("test", CLASSES)


def building_update(
    length: int = 30, objects: int = 20, seed: int = 0, query: str | None = "p5", spacing: float = 1.0, seq: int = 0
) -> SceneGraphUpdate:
    """A full update: a corridor of ``length`` places, one every ``spacing`` metres."""
    rng = np.random.default_rng(seed)
    parents = rng.integers(0, length, objects)
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=1_000_000_000,
        frame_id="odom",
        seq=seq,
        full=True,
        places=[Place(id=f"p{i}", position=(i * spacing, 0.0, 0.0)) for i in range(length)],
        objects=[
            Object(id=f"o{k}", class_=CLASSES[int(rng.integers(len(CLASSES)))], position=(p * spacing, 1.0, 0.0))
            for k, p in enumerate(parents.tolist())
        ],
        edges=[(f"p{i}", f"p{i + 1}") for i in range(length - 1)]
        + [(f"p{p}", f"o{k}") for k, p in enumerate(parents.tolist())],
        query_place=query,
    )


def delta(seq: int, stamp_ns: int | None = None, query: str | None = None, **parts) -> SceneGraphUpdate:
    """A delta with only what is given."""
    stamp_ns = 1_000_000_000 + seq * 500_000_000 if stamp_ns is None else stamp_ns
    fields = {"places": [], "objects": [], "edges": []} | parts
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=stamp_ns, frame_id="odom", seq=seq, full=False, query_place=query, **fields,
    )  # fmt: skip


def make_model(name: str = "paper", seed: int = 0, space: Labelspace = SPACE, temperature: float = 0.05) -> Model:
    """An encoder with random weights: what it learns is not what these tests look at."""
    import torch

    encoder = build_encoder(name, None, len(space), torch.Generator().manual_seed(seed)).eval()
    return Model(encoder=encoder, labelspace=space, seed=seed, temperature=temperature, provenance={})


def make_map(path: Path, model: Model, **buildings: SceneGraphUpdate) -> LoadedMap:
    """Write a map of the buildings given, and load it."""
    with MapDatabase.create(path, model) as database:
        for name, update in buildings.items():
            graph = SceneGraph()
            graph.apply(update)
            arrays = GraphArrays.from_scene_graph(graph, model.labelspace, name)
            database.add_building(name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))
    return load(path)
