"""What is timed: the generated office, a walk through it, and maps of any size that hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core import wire
from semloc_core.encoding import Model, build_encoder, embed_graph
from semloc_core.graph import GraphArrays
from semloc_core.map_database import LoadedMap
from semloc_core.sources import OfficeConfig, SimulationConfig, make_office, simulate_traversal
from semloc_core.text import short_repr

TEMPERATURE = 0.05
NOISE = 0.3


@short_repr
@dataclass(frozen=True, eq=False)
class BenchCase:
    """The office, an encoder of random weights (what it has learnt does not change its speed), and a run.

    Args:
        model: the paper's encoder.
        arrays: the office, of about 1,300 places.
        embeddings: (P, 32) float32 of its places.
        updates: the run as JSON text, the first a full update.

    """

    model: Model
    arrays: GraphArrays
    embeddings: NDArray[np.float32]
    updates: Sequence[bytes]

    def map_of(self, n_places: int, seed: int = 0) -> LoadedMap:
        """A map in memory: the office, and buildings like it up to ``n_places`` (fewer: a part of the office).

        The others' embeddings are the office's with noise added, so that a query has many near matches, as it
        would among many offices.
        """
        rng = np.random.default_rng(seed)
        p = self.arrays.n_places
        rows = np.arange(n_places) % p
        embeddings = self.embeddings[rows].copy()
        embeddings[p:] += rng.normal(0, NOISE / embeddings.shape[1] ** 0.5, embeddings[p:].shape).astype(np.float32)
        embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True).clip(1e-9)
        building = (np.arange(n_places) // p).astype(np.int32)
        return LoadedMap(
            name="bench",
            hash="0" * 64,
            model=self.model,
            buildings=tuple(f"office {i:05d}" for i in range(int(building[-1]) + 1)),
            place_ids=tuple(self.arrays.place_ids[row] for row in rows.tolist()),
            positions=self.arrays.place_positions[rows],
            building_index=building,
            embeddings=np.ascontiguousarray(embeddings, dtype=np.float32),
        )


def make_bench_case(seed: int = 0, distance_m: float = 60.0) -> BenchCase:
    """Make the case; the same seed gives the same."""
    world = make_office(OfficeConfig(), np.random.default_rng(seed))
    encoder = build_encoder("paper", None, len(world.labelspace), torch.Generator().manual_seed(seed)).eval()
    model = Model(encoder, world.labelspace, seed=seed, temperature=TEMPERATURE)
    arrays = GraphArrays.from_scene_graph(world.graph, world.labelspace, "office")
    config = SimulationConfig(distance_m=distance_m, range_m=10.0)
    steps = simulate_traversal(world.graph, config, np.random.default_rng(seed + 1))
    return BenchCase(model, arrays, embed_graph(model, arrays), tuple(wire.encode(step.update) for step in steps))
