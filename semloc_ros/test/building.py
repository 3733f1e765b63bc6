# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""A small building, maps of it and a run through it: made anew for each test session."""

import itertools
from pathlib import Path

import numpy as np
import torch

from semloc_core.encoding import Model, build_encoder, embed_graph
from semloc_core.graph import GraphArrays, Labelspace, SceneGraph
from semloc_core.map_database import MapDatabase
from semloc_core.sources import SimulationConfig, node_id, simulate_traversal, write_hydra, write_run
from semloc_core.wire import Object, Place, SceneGraphUpdate

CLASSES = ("chair", "couch", "plant", "painting", "lamp", "shelf")
SPACE = Labelspace("test", CLASSES, ids={name: (i,) for i, name in enumerate(CLASSES)})


def corridor(length=40, objects=60, seed=0):
    """A corridor of places a metre apart, objects along it."""
    rng = np.random.default_rng(seed)
    places = [node_id("p", i) for i in range(length)]
    parents = rng.integers(0, length, objects).tolist()
    things = [
        Object(node_id("O", k), CLASSES[int(rng.integers(len(CLASSES)))], (float(p), 1.0, 0.0))
        for k, p in enumerate(parents)
    ]
    return SceneGraph.from_update(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            seq=0,
            full=True,
            places=[Place(name, (float(i), 0.0, 0.0)) for i, name in enumerate(places)],
            objects=things,
            edges=[
                *itertools.pairwise(places),
                *((places[p], o.id) for p, o in zip(parents, things, strict=True)),
            ],
            query_place=places[5],
        )
    )


def make_model(name, temperature=0.005):
    """An encoder as it is before training: good enough to find a place again."""
    encoder = build_encoder(name, None, len(CLASSES), torch.Generator().manual_seed(0)).eval()
    return Model(encoder=encoder, labelspace=SPACE, seed=0, temperature=temperature, provenance={})


def write_map(path, model, **buildings):
    """Write a map of some graphs."""
    with MapDatabase.create(path, model) as database:
        for name, graph in buildings.items():
            arrays = GraphArrays.from_scene_graph(graph, model.labelspace, name)
            database.add_building(name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))
    return path


def steps(graph, **options):
    """A walk without detector errors, so that it is found again."""
    config = SimulationConfig.of(
        **{"distance_m": 20.0, "rate_hz": 5.0, "miss_rate": 0.0, "false_rate": 0.0, "position_noise_m": 0.0, **options}
    )
    return list(simulate_traversal(graph, config, np.random.default_rng(1)))


def make_all(folder: Path):
    """All that the tests need, in a folder."""
    home, other = corridor(), corridor(seed=7)
    write_hydra(folder / "home.json", home, SPACE)
    write_map(folder / "home.map", make_model("rings"), home=home)
    write_map(folder / "attention.map", make_model("paper"), home=home)
    write_map(folder / "twins.map", make_model("rings"), here=home, there=home)
    write_map(folder / "both.map", make_model("rings"), home=home, other=other)
    (folder / "broken.map").write_bytes((folder / "home.map").read_bytes()[:5000])
    write_run(folder / "run.mcap", steps(home))
    return folder
