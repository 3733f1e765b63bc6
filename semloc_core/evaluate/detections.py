"""How well a robot is found by detections and odometry, beside the same walks as scene graphs of a mapper."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import FileFormatError
from semloc_core.graph import Reading, SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.sources import (
    DetectorConfig,
    SimulationConfig,
    read_hydra,
    read_run,
    simulate_detections,
    simulate_traversal,
    write_detections,
    write_run,
)

WAYS = ("graphs", "detections")


def evaluate_detections(
    root: Path,
    loaded: LoadedMap,
    *,
    walks: int,
    metres: float,
    cameras: int,
    seed: int,
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> list[dict[str, Any]]:
    """Walk buildings on their second day, and ask where the robot is after some metres.

    Args:
        root: ``*/query.json``, in folders by the buildings' names.
        loaded: the map of their first days.
        walks: a building.
        metres: walked when it is asked.
        cameras: of the robot, 90° each.
        seed: of all that is random.
        progress: called with (done, total, building).

    Returns:
        A row for each way: success@1 within 4 m, and the errors of the poses of right answers.

    """
    folders = sorted(path.parent for path in root.glob("*/query.json"))
    if not folders:
        raise FileFormatError(f"expected buildings in {root}: */query.json (got none)")
    found: dict[str, list[tuple[bool, float]]] = {way: [] for way in WAYS}
    reading = Reading().with_known(loaded.model.labelspace)
    with TemporaryDirectory() as scratch:
        for i, folder in enumerate(folders):
            progress(i, len(folders), folder.name)
            graph = read_hydra(folder / "query.json", reading).graph
            for walk in range(walks):
                for way, run in _runs(Path(scratch), graph, metres, cameras, [seed, i, walk]):
                    found[way].append(_asked(Localiser(loaded), run, folder.name))
    return [_row(way, metres, found[way]) for way in WAYS]


def _runs(scratch: Path, graph: SceneGraph, metres: float, cameras: int, seed: list[int]) -> Iterator[tuple[str, Path]]:
    """The same walk twice: as what a mapper publishes, and as what a detector sees."""
    step = SimulationConfig.of(distance_m=metres, shared_frame=True)
    write_run(scratch / "graphs.mcap", simulate_traversal(graph, step, np.random.default_rng(seed)))
    yield WAYS[0], scratch / "graphs.mcap"
    config = DetectorConfig.of(distance_m=metres, cameras=cameras)
    write_detections(scratch / "run.mcap", simulate_detections(graph, config, np.random.default_rng(seed)))
    yield WAYS[1], scratch / "run.mcap"


def _asked(localiser: Localiser, run: Path, building: str) -> tuple[bool, float]:
    """Whether the last answer of a run is right, and how far its pose is off, m."""
    for item in read_run(run):
        answer, truth = localiser.update(item.text).matches, item.truth
    best = answer.matches[0] if answer is not None and answer.matches else None
    if best is None or truth is None or best.map != building:
        return False, math.nan
    off = math.nan if best.pose is None else math.dist(best.pose.position, truth.position)
    return math.dist(best.position, truth.position) <= MATCH_RADIUS_M, off


def _row(way: str, metres: float, found: list[tuple[bool, float]]) -> dict[str, Any]:
    off = [metres_off for right, metres_off in found if right and not math.isnan(metres_off)]
    return {
        "method": way,
        "scope": f"{metres:g}m",
        "queries": len(found),
        "success@1": float(np.mean([right for right, _ in found])),
        "position_error_m": float(np.median(off)) if off else None,
        "position_error_m_p90": float(np.quantile(off, 0.9)) if off else None,
    }
