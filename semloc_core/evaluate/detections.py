"""How well a robot is found by detections and odometry, beside the same walks as scene graphs of a mapper.

A mapper's graph has what is around the robot, cameras have what is before them: what is lost by that is told apart from
what is lost by detecting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec
import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import FileFormatError
from semloc_core.graph import Floats, Reading, SceneGraph, UpdateStream
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.sources import (
    DetectorConfig,
    Grid,
    SimulationConfig,
    read_hydra,
    read_run,
    simulate_detections,
    simulate_traversal,
    write_detections,
    write_run,
)
from semloc_core.wire import SceneGraphUpdate

WAYS = ("graphs", "graphs, same field of view", "detections", "detections and a grid")
"""The mapper's graph, the same without what no camera had in sight, what the detector saw, and the same with the
occupancy grid that a laser made on the way."""
FREE_M, CELL_M, LASER_M = 0.75, 0.1, 5.0
"""What is nearer to a place of the building is free; a grid's cells; how far a laser looks."""
STOREY_M = 1.0
"""What is farther from the way in height is another floor."""
_SAME_M = 1e-6


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
        A row for each way: success@1 within 4 m, the objects known when it was asked (mean), and the errors of the
        poses of right answers.

    """
    folders = sorted(path.parent for path in root.glob("*/query.json"))
    if not folders:
        raise FileFormatError(f"expected buildings in {root}: */query.json (got none)")
    found: dict[str, list[_Asked]] = {way: [] for way in WAYS}
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
    """The same walk as what a mapper publishes, as that of it which cameras had in sight, and as what they detected."""
    step = SimulationConfig.of(distance_m=metres, shared_frame=True)
    write_run(scratch / "graphs.mcap", simulate_traversal(graph, step, np.random.default_rng(seed)))
    yield WAYS[0], scratch / "graphs.mcap"
    step = SimulationConfig.of(distance_m=metres, shared_frame=True, fresh_ids=False)
    steps = list(simulate_traversal(graph, step, np.random.default_rng(seed)))
    seen = in_view(graph, [one.update for one in steps], metres, cameras, seed)
    write_run(scratch / "seen.mcap", [one._replace(update=without(one.update, seen)) for one in steps])
    yield WAYS[1], scratch / "seen.mcap"
    config = DetectorConfig.of(distance_m=metres, cameras=cameras)
    glances = list(simulate_detections(graph, config, np.random.default_rng(seed)))
    write_detections(scratch / "run.mcap", glances)
    yield WAYS[2], scratch / "run.mcap"
    seen_from = np.array([glance.position for glance in glances])
    write_detections(scratch / "walls.mcap", glances, grid=scanned(graph, seen_from))
    yield WAYS[3], scratch / "walls.mcap"


def scanned(graph: SceneGraph, way: Floats) -> Grid:
    """What a laser makes of a building's floor from a way (N, 3), metres: what it had in sight, free around places."""
    places = np.array([at for at in graph.places.values() if np.abs(at[2] - way[:, 2]).min() < STOREY_M])[:, :2]
    low = np.minimum(places.min(axis=0), way[:, :2].min(axis=0)) - 1.0
    columns, rows = np.ceil((np.maximum(places.max(axis=0), way[:, :2].max(axis=0)) + 1.0 - low) / CELL_M).astype(int)
    cells = np.full((rows, columns), 100, dtype=np.int8)
    whole = Grid(cells, CELL_M, (float(low[0]), float(low[1]), 0.0))
    row, column = (each.ravel() for each in np.mgrid[:rows, :columns])
    at = whole.centres(row, column)
    ends = np.array([(graph.places[a][:2], graph.places[b][:2]) for a in graph.places for b in graph.neighbours[a]])
    on = np.abs(np.array([graph.places[a][2] for a in graph.places for _ in graph.neighbours[a]])[:, None] - way[:, 2])
    along = [a + share * (b - a) for a, b in ends[on.min(axis=1) < STOREY_M] for share in (0.25, 0.5, 0.75)]
    for x, y in [*places.tolist(), *along]:
        cells[row, column] = np.where(np.hypot(at[:, 0] - x, at[:, 1] - y) < FREE_M, 0, cells[row, column])
    seen = np.zeros(len(at), dtype=np.bool_)
    for here in way[:: max(1, round(LASER_M / 10 / CELL_M)), :2]:
        asked = np.flatnonzero(~seen & (np.hypot(*(at - here).T) <= LASER_M))
        seen[asked] = whole.sight(np.broadcast_to(here, (len(asked), 2)), at[asked], CELL_M)
    return Grid(np.where(seen.reshape(rows, columns), cells, -1).astype(np.int8), CELL_M, whole.origin)


def in_view(
    graph: SceneGraph, updates: Iterable[SceneGraphUpdate], metres: float, cameras: int, seed: list[int]
) -> set[str]:
    """Ids of the objects of a mapper's updates that cameras have in sight at all along the walk.

    The updates have the building's own ids. A detector that errs in nothing looks at what the mapper published.
    """
    mapper = UpdateStream()
    for update in updates:
        mapper.apply(update)
    known, whole = mapper.graph, graph.to_update(0, 0, "map")
    assert known is not None
    things = list(known.objects.values())
    edges = [edge for edge in whole.edges if not graph.objects.keys() & {*edge}]
    edges += [(place, thing.id) for thing in things for place in sorted(known.parents[thing.id])]
    published = SceneGraph.from_update(msgspec.structs.replace(whole, objects=things, edges=edges))
    faultless = DetectorConfig.of(
        distance_m=metres, cameras=cameras, miss_rate=0.0, confusion_rate=0.0, false_rate=0.0, depth_noise=0.0
    )
    at = np.array([thing.position for thing in things]).reshape(-1, 3)
    found: set[str] = set()
    for glance in simulate_detections(published, faultless, np.random.default_rng(seed)):
        for mount, detections in glance.frames:
            sensor = glance.odometry @ mount
            for one in detections:
                off = np.abs(at - (sensor @ one.pose).translation).max(axis=1)
                found.update(things[i].id for i in np.flatnonzero(off <= _SAME_M).tolist())
    return found


def without(update: SceneGraphUpdate, seen: set[str]) -> SceneGraphUpdate:
    """An update of a run in which the objects but some were never there."""
    objects = [thing for thing in update.objects if thing.id in seen]
    gone = {thing.id for thing in update.objects} - {thing.id for thing in objects}
    edges = [edge for edge in update.edges if not gone & {*edge}]
    return msgspec.structs.replace(update, objects=objects, edges=edges)


class _Asked(NamedTuple):
    """Whether an answer is right, how far its pose is off (m; NaN: none), and how many objects were known."""

    right: bool
    off: float
    objects: int


def _asked(localiser: Localiser, run: Path, building: str) -> _Asked:
    """What becomes of the answer at the end of a run: nothing before it is asked."""
    truth = None
    for item in read_run(run):
        localiser.apply(item.text)
        truth = item.truth
    answer = localiser.locate().matches
    best = answer.matches[0] if answer.matches else None
    known = 0 if localiser.live.graph is None else len(localiser.live.graph.objects)
    if best is None or truth is None or best.map != building:
        return _Asked(False, math.nan, known)
    off = math.nan if best.pose is None else math.dist(best.pose.position, truth.position)
    return _Asked(math.dist(best.position, truth.position) <= MATCH_RADIUS_M, off, known)


def _row(way: str, metres: float, found: list[_Asked]) -> dict[str, Any]:
    off = [one.off for one in found if one.right and not math.isnan(one.off)]
    return {
        "method": way,
        "scope": f"{metres:g}m",
        "queries": len(found),
        "success@1": float(np.mean([one.right for one in found])),
        "objects": float(np.mean([one.objects for one in found])),
        "position_error_m": float(np.median(off)) if off else None,
        "position_error_m_p90": float(np.quantile(off, 0.9)) if off else None,
    }
