"""What each part of verification by layout is worth: the same fragments, asked with a part left out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.evaluate.online.answers import by_chance, make_walks, steps_at, verdict
from semloc_core.evaluate.online.verified import groups_of, success_rows
from semloc_core.evaluate.relocalise import make_arena, read_buildings, read_distractors
from semloc_core.evaluate.verified_answers import fragments_along
from semloc_core.graph import union
from semloc_core.matching import LayoutConfig, LayoutVerifier
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig

SCOPES_M = (0.0, 5.0, 10.0, 20.0)
FULL = LayoutConfig()
VARIANTS: dict[str, LayoutConfig] = {
    "layout": FULL,
    "objects missed do not count": msgspec.structs.replace(FULL, looked=0.0),
    "free space does not count": msgspec.structs.replace(FULL, room_weight=0.0),
    "neither does": msgspec.structs.replace(FULL, looked=0.0, room_weight=0.0),
    "the robot's floor only": msgspec.structs.replace(FULL, floor_m=1.5),
    "6 m around the robot": msgspec.structs.replace(FULL, reach_m=6.0),
    "no places proposed by the scan": msgspec.structs.replace(FULL, coarse=0),
    "no places proposed by pairs of objects": msgspec.structs.replace(FULL, voted=0),
    "poses aligned by votes alone": msgspec.structs.replace(FULL, wide=1),
    "100 places of each, 10 poses": msgspec.structs.replace(FULL, voted=100, coarse=100, fine=10),
    "1000 places of each, 100 poses": msgspec.structs.replace(FULL, voted=1000, coarse=1000, fine=100),
}


def evaluate_layout(
    root: Path,
    *,
    walks: int = 5,
    scopes_m: Sequence[float] = SCOPES_M,
    distractors: Sequence[Path] = (),
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@1/5/10 by metres walked, of verification with a part left out; without an embedding.

    Args:
        root: holds a folder a building, each with ``map.json`` and ``query.json``.
        walks: walks a building, on average.
        scopes_m: metres walked at which answers are judged.
        distractors: folders of buildings that are only in the map, as of `read_distractors`.
        seed: of walks, of the robots' frames and of the bootstrap.
        progress: told of every variant.

    Returns:
        A row a variant (``method``) and distance (``scope``), as of `semloc_core.evaluate.online.protocol`.

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.

    """
    buildings, others = read_buildings(root), read_distractors(distractors)
    files = [file for building in buildings for file in (building.map, building.query)]
    labelspace = union([file.labelspace for file in (*files, *others)])
    arena = make_arena(buildings, labelspace, others)
    paths = make_walks(arena, WalkConfig(distance_m=max(*scopes_m, 1e-9)), walks, seed)
    rows: list[Row] = []
    every = [np.arange(graph.n_places) for graph in arena.maps]
    for done, (name, config) in enumerate(VARIANTS.items()):
        progress(done, len(VARIANTS), name)
        verifier = LayoutVerifier(arena.maps, every, len(labelspace), config)
        right = np.zeros((len(paths), len(scopes_m), max(metrics.RANKS)), np.bool_)
        chance = np.zeros(right.shape[:2])
        for i, path in enumerate(paths):
            at = steps_at(path.walk, scopes_m)
            chance[i] = by_chance(arena, path, at, MATCH_RADIUS_M)
            best = np.full(right.shape[1:], -1, dtype=np.int64)
            for k, fragment in enumerate(fragments_along(path.walk, at, verifier, np.random.default_rng([seed, i]))):
                found = verifier.verify(fragment)
                if found is not None:
                    listed = found.rows[: best.shape[1]]
                    best[k, : len(listed)] = listed
            right[i] = verdict(arena, path, at, best, MATCH_RADIUS_M)
        rows += success_rows({"method": name}, right, chance, groups_of(paths), scopes_m, seed)
    progress(len(VARIANTS), len(VARIANTS), "done")
    return rows
