"""Robots that share a map: each with the embedded file, and all on one server, as the map and the fleet grow."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from semloc_core import wire
from semloc_core.benchmark.map_server import FleetServer
from semloc_core.benchmark.timing import held_mib
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import embed_graph, general_model
from semloc_core.errors import MapError
from semloc_core.evaluate import draw_buildings
from semloc_core.fleet import FleetLocaliser, Holdings, Link, LoadedSource, MilvusSource, localiser_in
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, MapDatabase, PlaceRows, StoredBuilding, load, pack_graph
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import KINDS, SimulationConfig, simulate_traversal

SIZES = (10, 200, 1000)
ROBOTS = (1, 8, 32)
SECONDS = 10.0
DRAWN = 12
"""Homes drawn; the others of a map are these, their embeddings with noise added: as many near matches as homes have."""
NOISE = 0.3
RUNS = 2
CONFIG = LocaliserConfig(explain_rate_hz=0.0, server_timeout_s=60.0)
FILE = "embedded file"

Run = Sequence[bytes]


def bench_fleet(
    folder: Path,
    server: FleetServer,
    sizes: Sequence[int] = SIZES,
    robots: Sequence[int] = ROBOTS,
    seconds: float = SECONDS,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """Answer updates (decode, apply, locate) of several robots at once, each a thread with a localiser of its own.

    Threads of one process share one core for their Python: ``per_s`` of many robots is what that core does for all of
    them, while in a fleet each has its own; the server has processes of its own. What does not hang on that are
    ``cpu_ms``, a robot's own work for an answer, and ``server_ms``, the server's CPU time for one.

    Args:
        folder: where the map files go.
        server: a map server.
        sizes: buildings of the maps.
        robots: how many at once.
        seconds: for how long each is measured; what the runs need of a large map has been fetched before.
        seed: of the homes and runs.
        progress: told of every measurement.

    Returns:
        Rows of the embedded file and of the server, for each size and number of robots: ``per_s`` answers of all
        robots together, ``p50_ms`` and ``p99_ms`` of one by the clock, ``cpu_ms``, ``server_ms`` (where it was started
        here), and for one robot ``held_mib`` as Python and numpy count it.

    """
    rng = np.random.default_rng(seed)
    drawn = max(RUNS, min(DRAWN, max(sizes)))
    homes, again, space = draw_buildings(KINDS["home"], drawn, rng)
    model = general_model(homes, space)
    packed = [pack_graph(home.to_scene_graph(space), "map") for home in homes]
    embedded = [embed_graph(model, home) for home in homes]
    walk = SimulationConfig(distance_m=15.0, rate_hz=2.0)
    runs = [
        [wire.encode(s.update) for s in simulate_traversal(g.to_scene_graph(space), walk, np.random.default_rng(seed))]
        for g in again[:RUNS]
    ]

    def homes_of(size: int) -> Iterator[tuple[StoredBuilding, PlaceRows]]:
        for number in range(size):
            home, z = homes[number % drawn], embedded[number % drawn]
            if number >= drawn:
                z = z + rng.normal(0, NOISE / z.shape[1] ** 0.5, z.shape).astype(np.float32)
                z /= np.linalg.norm(z, axis=1, keepdims=True)
            name = f"home/{number:05d}"
            stored = StoredBuilding(name, "", "map", None, home.n_places, packed[number % drawn])
            yield stored, PlaceRows(home.place_ids, home.place_positions, np.ascontiguousarray(z, dtype=np.float32))

    rows: list[Row] = []
    for step, size in enumerate(sizes):
        progress(step, len(sizes), f"{size} homes into a file, and onto the server")
        path = folder / f"homes_{size}.map"
        with MapDatabase.create(path, model) as database, database.transaction():
            for stored, places in homes_of(size):
                database.copy_building(stored, places)
        server.keep(path)
        for kept in (_InFile(path), _OnServer(server, path.stem)):
            progress(step, len(sizes), f"{size} homes, {kept.method}")
            held = _held(kept.robot, runs[0])
            kept.fetch(runs)
            for count in robots:
                progress(step, len(sizes), f"{size} homes, {kept.method}, {count} robots")
                row: Row = {"method": kept.method, "scope": f"{size:,} homes", "robots": count}
                row |= _together([kept.robot() for _ in range(count)], runs, seconds, kept.server_s)
                rows.append(row | ({"held_mib": held} if count == robots[0] else {}))
    return rows


class _Robots(ABC):
    """Robots on one map; here they share the memory of what was fetched."""

    method: str
    _holdings: Holdings | None = None

    @abstractmethod
    def robot(self) -> Localiser:
        """A robot, with what was fetched."""

    def server_s(self) -> float | None:
        """CPU time of the server so far; None where none works for them."""
        return None

    def fetch(self, runs: Sequence[Run]) -> None:
        """What robots on these runs need: it is fetched once."""
        scout = self.robot()
        if isinstance(scout, FleetLocaliser):
            for update in (update for run in runs for update in run):
                _answer(scout, update)
            self._holdings = scout.holdings
            scout.close()

    def _narrowed(self, source: LoadedSource | MilvusSource) -> FleetLocaliser:
        held = None if self._holdings is None else self._holdings.copy()
        return FleetLocaliser(Link(source, np.random.default_rng(0)), CONFIG, holdings=held)


class _InFile(_Robots):
    """Robots that hold the map; here they share its memory, which robots can't."""

    method = FILE

    def __init__(self, path: Path) -> None:
        self._path = path

    @cached_property
    def _loaded(self) -> LoadedMap:
        return load(self._path)

    @cached_property
    def _source(self) -> LoadedSource:
        return LoadedSource(self._loaded)

    def robot(self) -> Localiser:
        """As a map file is opened: one that is too large to be looked at whole is narrowed to some buildings."""
        made = localiser_in(self._loaded, CONFIG)
        return self._narrowed(self._source) if isinstance(made, FleetLocaliser) else made


class _OnServer(_Robots):
    """Robots that ask a server, each over a line of its own."""

    def __init__(self, server: FleetServer, name: str) -> None:
        self.method, self._server, self._name = server.name, server, name

    def server_s(self) -> float | None:
        """CPU time of the server so far."""
        return self._server.cpu_s()

    def robot(self) -> FleetLocaliser:
        """With what was fetched."""
        return self._narrowed(self._server.source(self._name, CONFIG.server_timeout_s, CONFIG.server_poll_s))


def _held(make: Callable[[], Localiser], run: Run) -> float:
    """`held_mib` of one robot that has answered: map and all."""
    robots: list[Localiser] = []

    def answered() -> None:
        robots.append(make())
        _answer(robots[0], run[0])

    held = held_mib(answered)
    robots[0].close()
    return held


def _together(
    robots: Sequence[Localiser], runs: Sequence[Run], seconds: float, server_s: Callable[[], float | None]
) -> Row:
    """Answers of all robots within some seconds."""
    ready, until = threading.Barrier(len(robots) + 1), [0.0]
    took: list[tuple[float, float]] = []
    failed: list[BaseException] = []

    def drive(robot: Localiser, run: Run) -> None:
        try:
            _answer(robot, run[0])
            ready.wait()
            ready.wait()  # all begin at once
            while True:
                for update in run:
                    wall, own = time.perf_counter(), time.thread_time()
                    _answer(robot, update)
                    took.append((time.perf_counter() - wall, time.thread_time() - own))
                    if time.perf_counter() > until[0]:
                        return
        except BaseException as error:
            failed.append(error)
            ready.abort()

    threads = [threading.Thread(target=drive, args=(r, runs[i % len(runs)])) for i, r in enumerate(robots)]
    for thread in threads:
        thread.start()
    began = spent = None
    try:
        ready.wait()
        began, spent = time.perf_counter(), server_s()
        until[0] = began + seconds
        ready.wait()
    except threading.BrokenBarrierError:
        pass  # `failed` says why
    for thread in threads:
        thread.join()
    for robot in robots:
        robot.close()
    if failed or began is None:
        raise failed[0]
    lasted, after = time.perf_counter() - began, server_s()
    times = np.array(took)
    return {
        "per_s": len(times) / lasted,
        "p50_ms": 1e3 * float(np.median(times[:, 0])),
        "p99_ms": 1e3 * float(np.percentile(times[:, 0], 99)),
        "cpu_ms": 1e3 * float(times[:, 1].mean()),
        "server_ms": None if spent is None or after is None else 1e3 * (after - spent) / len(times),
        "answers": len(times),
    }


def _answer(robot: Localiser, update: bytes) -> None:
    located = robot.update(update).located
    if located is None or located.matches.status == "no_graph":
        reason = located.query.reason if located is not None else "a repeated update"
        raise MapError(f"expected an answer of every robot (got none: {reason})")
