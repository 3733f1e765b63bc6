"""Sound inputs of every kind, small, made by this project's own writers: what fuzzing starts from."""

from __future__ import annotations

import io
import re
from functools import cache
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from small_building import CLASSES, building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources.bag import BagWriter, encode_string
from semloc_core.sources.hydra.write import node_id, write_hydra
from semloc_core.sources.simulate.traversal import SimulationConfig, simulate_traversal
from semloc_core.wire import Object, Place

EXAMPLES = Path(__file__).resolve().parents[2] / "msgs_schema"
YAML = b"""name: test
classes:
- {name: chair, ids: [1, 2], mobility: 0.5}
- {name: couch, ids: [3]}
- {name: "12", ids: [4]}
synonyms: {sofa: couch}
"""


def messages() -> tuple[bytes, ...]:
    """The schemas' examples, also those that must be refused."""
    return tuple(path.read_bytes() for path in sorted(EXAMPLES.glob("*/**/*.json")))


@cache
def updates() -> tuple[bytes, ...]:
    """Fulls of a small building, and deltas of every kind."""
    full = building_update(12, 8)
    found = [full, building_update(12, 8, query=None), building_update(5, 3, seed=1, query="p2")]
    found += [
        delta(1, query="p5"),
        delta(
            1, query="p1", places=[Place("p1", (1.0, 0.5, 0.0)), Place("new", (2.0, 1.0, 0.0))], edges=[("new", "p1")]
        ),
        delta(1, query="p1", objects=[Object("o9", CLASSES[0], (0.0,) * 3, (1.0, 2.0, 0.5))], edges=[("p3", "o9")]),
        delta(1, query="p1", removed_nodes=["p4", "o1"], removed_edges=[("p7", "p8")]),
        delta(1, query="p6", sightings=[("p6", "o1"), ("p5", "o1")]),
    ]
    return tuple(wire.encode(update) for update in found)


def graph() -> SceneGraph:
    """The small building."""
    return SceneGraph.from_update(building_update(12, 8))


def hydra(folder: Path) -> tuple[bytes, ...]:
    """A scene-graph file."""
    text = wire.encode(building_update(12, 8)).decode()
    text = re.sub(r'"([po])(\d+)"', lambda found: f'"{node_id(found[1].upper(), int(found[2]))}"', text)
    numbered = SceneGraph.from_update(wire.decode_update(text))
    write_hydra(folder / "seed.json", numbered, Labelspace("test", CLASSES))
    return ((folder / "seed.json").read_bytes(),)


def bags(folder: Path) -> tuple[bytes, ...]:
    """A run in each compression, and one without any CRC, where damage is not noticed before it is read."""
    config = SimulationConfig(distance_m=4.0)
    steps = [step.update for step in simulate_traversal(graph(), config, np.random.default_rng(0))][:6]
    found = []
    for compression in ("none", "zstd", "lz4"):
        path = folder / f"{compression}.mcap"
        with BagWriter(path, compression=compression) as bag:
            for step in steps:
                bag.write_string("/scene_graph", step.stamp_ns, wire.encode(step))
                bag.write_point("/ground_truth", step.stamp_ns, "map", (0.0, 1.0, 2.0))
        found.append(path.read_bytes())
    for compression_type in (CompressionType.NONE, CompressionType.LZ4):
        stream = io.BytesIO()
        writer = Writer(stream, 4096, compression_type, enable_crcs=False, enable_data_crcs=False)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/scene_graph", "cdr", schema)
        for step in steps:
            writer.add_message(channel, step.stamp_ns, encode_string(wire.encode(step)), step.stamp_ns)
        writer.finish()
        found.append(stream.getvalue())
    return tuple(found)


def maps(folder: Path) -> tuple[bytes, ...]:
    """A map of two buildings."""
    path = folder / "seed.map"
    if not path.exists():
        make_map(path, make_model("paper"), a=building_update(12, 8), b=building_update(5, 3, seed=1, query="p2"))
    return (path.read_bytes(),)


def models() -> tuple[bytes, ...]:
    """A checkpoint of every kind of encoder with weights."""
    return tuple(make_model(name).to_bytes() for name in ("paper", "rings", "geodesic_attention"))
