"""How time and memory grow with the map, the graph, the objects in reach and the classes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch

from semloc_core import wire
from semloc_core.benchmark.case import BenchCase
from semloc_core.benchmark.timing import Times, clocked, held_mib
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Model, build_encoder
from semloc_core.graph import Labelspace
from semloc_core.localiser import Localiser
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.wire import Object, Place, SceneGraphUpdate

SIZES = {
    "places of the map": (1_000, 10_000, 100_000, 1_000_000),
    "places of the graph": (100, 1_000, 10_000),
    "objects in reach": (5, 20, 80, 320),
    "classes": (5, 20, 80, 320),
}
SIDE, PITCH_M = 10, 1.0


def corridor(places: int, objects: int, classes: Sequence[str], seq: int = 0) -> SceneGraphUpdate:
    """A full update: a strip ten places wide, and objects around the query place, which is in its middle."""
    rng = np.random.default_rng(0)
    rows = max(1, places // SIDE)
    at = [(PITCH_M * (i // SIDE), PITCH_M * (i % SIDE), 0.0) for i in range(rows * SIDE)]
    edges = [(f"p{i}", f"p{i + 1}") for i in range(len(at)) if (i + 1) % SIDE]
    edges += [(f"p{i}", f"p{i + SIDE}") for i in range(len(at) - SIDE)]
    middle = (rows // 2) * SIDE + SIDE // 2
    near = [i for i in range(len(at)) if abs(at[i][0] - at[middle][0]) <= 2 and abs(at[i][1] - at[middle][1]) <= 2]
    parents = [near[int(rng.integers(len(near)))] for _ in range(objects)]
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=seq,
        frame_id="map",
        seq=seq,
        full=True,
        places=[Place(f"p{i}", point) for i, point in enumerate(at)],
        objects=[Object(f"o{k}", classes[k % len(classes)], at[i]) for k, i in enumerate(parents)],
        edges=edges + [(f"p{i}", f"o{k}") for k, i in enumerate(parents)],
        query_place=f"p{middle}",
    )


def bench_growth(case: BenchCase, repeats: int = 20, progress: Progress = no_progress) -> list[Row]:
    """Time a delta that moves the query place, one thing growing at a time, the rest as small as it was.

    Args:
        case: gives the map.
        repeats: deltas timed at each size.
        progress: told of every size.

    Returns:
        A row a size: ``scope`` what grows, ``size``, ``p50_ms`` (clock), ``cpu_ms``, ``memory_mib`` that the
        localiser allots beyond the map it is given.

    """
    rows: list[Row] = []
    for scope, sizes in SIZES.items():
        for size in sizes:
            progress(len(rows), sum(map(len, SIZES.values())), f"{scope}: {size}")
            row: Row = {"method": "semloc", "scope": scope, "size": size}
            rows.append(row | _one(case, scope, size, repeats))
    return rows


def _one(case: BenchCase, scope: str, size: int, repeats: int) -> Row:
    classes = case.model.labelspace.classes
    if scope == "classes":
        space = Labelspace("bench", tuple(f"class {i}" for i in range(size)))
        encoder = build_encoder("paper", None, size, torch.Generator().manual_seed(0)).eval()
        case = BenchCase(Model(encoder, space, temperature=0.05), case.arrays, case.embeddings, ())
        classes = space.classes
    loaded = case.map_of(size if scope == "places of the map" else 1_000)
    full = corridor(
        size if scope == "places of the graph" else 400, size if scope == "objects in reach" else 20, classes
    )

    def start() -> Localiser:
        localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0, max_update_bytes=2**28))
        localiser.update(full)
        return localiser

    memory = held_mib(start)
    localiser, took = start(), Times()
    moved = next(place for place in full.places if place.id == full.query_place)
    for seq in range(1, repeats + 1):
        x, y, z = moved.position
        delta = SceneGraphUpdate(
            schema=full.schema, stamp_ns=seq, frame_id="map", seq=seq, full=False, objects=[], edges=[],
            places=[Place(moved.id, (x + 0.01 * (seq % 7), y, z))], query_place=moved.id,
        )  # fmt: skip
        text = wire.encode(delta)
        clocked(took, str(seq), partial(localiser.update, text))
    wall, own = 1e3 * np.median(list(took.values()), axis=0)
    return {"p50_ms": float(wall), "cpu_ms": float(own), "memory_mib": memory, "repeats": repeats}
