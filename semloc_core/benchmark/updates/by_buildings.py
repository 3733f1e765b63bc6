"""An update as a node answers it, by how many buildings the map has: test by layout, attribution and evidence.

Beside it CLIPPER, which registers what the robot has seen against every building, in the same run.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from semloc_core import wire
from semloc_core.benchmark.timing import Times, clocked, is_full, timed_row
from semloc_core.benchmark.updates.homes import Homes
from semloc_core.config import LocaliserConfig
from semloc_core.evaluate import ClipperConfig, original_clipper, register_clipper
from semloc_core.fleet import localiser_in
from semloc_core.graph import Floats, Ints, SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.text import short_repr

SIZES = (1, 18, 100, 200, 1_000, 10_000)
PEER_UP_TO = 100
WHOLE, FULL = "semloc", "· full updates, each with all that was seen"
STEPS = ("read and apply", "locate: search and test", "attribution", "evidence", "write")
PEER, ORIGINAL = "clipper", "clipper, original"
PEER_ANSWERS = 12
ROBOTS, ROBOTS_UPDATES = 32, 40
CONFIG = LocaliserConfig(explain_rate_hz=1000.0, max_update_bytes=2**28)


@short_repr
@dataclass(frozen=True, eq=False)
class Seen:
    """All objects that a robot has seen so far: (n, 3) metres, in its frame, and their (n,) classes."""

    objects: Floats
    classes: Ints


def bench_update(
    homes: Homes,
    sizes: Sequence[int],
    peer_up_to: int = PEER_UP_TO,
    rounds: int = 1,
    robots: int = ROBOTS,
    progress: Progress = no_progress,
) -> list[Row]:
    """Time updates on maps of the first homes.

    A map is opened as a map file is (`semloc_core.fleet.localiser_in`). The runs are walked once before, untimed: what
    a map narrowed to some of its buildings has to read of them has been read then.

    Args:
        homes: enough for the largest map.
        sizes: of the maps, buildings.
        peer_up_to: CLIPPER is timed on maps of so many buildings at most.
        rounds: how often the runs are walked and timed.
        robots: how many robots share the map, and the core, by turns.
        progress: told of every map.

    Returns:
        For each map: the whole update but for full ones, from JSON to matches, attributions and evidence in JSON; its
        steps; full updates; the robots' answers (without attributions) a second of CPU time, ``per_s``; the peer.
        ``ratio`` is the row's own CPU time over the whole update's, ``cpu_p99_ms`` what one in a hundred takes longer
        than, ``buildings`` and ``places`` the map's size, ``open_s`` how long it took to open it.

    """
    rows: list[Row] = []
    for number, size in enumerate(sizes):
        progress(number, len(sizes), f"updates, map of {size} buildings")
        some = homes.first(size)
        loaded = some.loaded()
        begun = time.perf_counter()
        localiser = localiser_in(loaded, CONFIG)
        keys: Row = {"buildings": size, "places": loaded.n_places, "open_s": time.perf_counter() - begun}
        scope = f"{size:,} of {homes.scope}"
        found, seen = _walked(scope, localiser, some.runs, rounds)
        found.append(_by_turns(scope, localiser, some.runs, robots))
        if size <= peer_up_to:
            progress(number, len(sizes), f"{PEER}, {size} buildings")
            found.append(_peer(scope, some, seen, float(found[0]["cpu_ms"] or 0.0)))
        localiser.close()
        rows += [row | keys for row in found]
    return rows


def _walked(
    scope: str, localiser: Localiser, runs: Sequence[Sequence[bytes]], rounds: int
) -> tuple[list[Row], list[Seen]]:
    """The rows of one robot, and what it had seen at each of its answers."""
    taken: list[Times] = []
    full: list[tuple[float, float]] = []
    seen: list[Seen] = []
    for round_ in range(rounds + 1):
        for text in (text for run in runs for text in run):
            took = _one_update(localiser, text)
            if not round_:
                graph = localiser.live.graph
                if took is not None and graph is not None:
                    seen.append(_seen(graph, localiser))
            elif took is not None and is_full(text):
                full.append(took["all"])
            elif took is not None:
                taken.append(took)
    whole = float(np.median([took["all"][1] for took in taken]))
    methods = {"all": WHOLE, **{step: f"· {step}" for step in STEPS}}
    rows = [_row(scope, method, [took[name] for took in taken], whole) for name, method in methods.items()]
    return [*rows, _row(scope, FULL, full, whole)] if full else rows, seen


def _one_update(localiser: Localiser, text: bytes) -> Times | None:
    """Seconds (clock, own) of one update and its steps; None where it has no answer to explain."""
    took: Times = {}
    clocked(took, STEPS[0], lambda: localiser.apply(text))
    located = clocked(took, STEPS[1], localiser.locate)
    if located.best_row is None or located.query.batch is None:
        return None
    attributions = clocked(took, STEPS[2], lambda: localiser.explain(located))
    evidence = clocked(took, STEPS[3], lambda: localiser.evidence(located))
    told = [message for message in (located.matches, attributions, evidence) if message is not None]
    clocked(took, STEPS[4], lambda: [wire.encode(message) for message in told])
    wall, own = np.sum([took[step] for step in STEPS], axis=0).tolist()
    return took | {"all": (wall, own)}


def _seen(graph: SceneGraph, localiser: Localiser) -> Seen:
    things, space = list(graph.objects.values()), localiser.map.model.labelspace
    classes = np.array([space.index(thing.class_) for thing in things], dtype=np.int64)
    objects = np.array([thing.position for thing in things], dtype=np.float64).reshape(-1, 3)
    return Seen(objects[classes >= 0], classes[classes >= 0])


def _by_turns(scope: str, first: Localiser, runs: Sequence[Sequence[bytes]], robots: int) -> Row:
    """Robots that share a map and a core: each answers one update of its run after the other."""
    config = LocaliserConfig(explain_rate_hz=0.0, max_update_bytes=CONFIG.max_update_bytes)
    fleet = [first.renewed(config) for _ in range(robots)]
    took: Times = {}
    taken: list[tuple[float, float]] = []
    for step in range(-1, ROBOTS_UPDATES):
        for i, robot in enumerate(fleet):
            run = runs[i % len(runs)]
            text = run[(step + 1) % len(run)]
            clocked(took, "", partial(_answered, robot, text))
            if step >= 0:  # the first is a full one for all
                taken.append(took[""])
    for robot in fleet:
        robot.close()
    row = _row(scope, f"{robots} robots by turns, no attributions", taken, float("nan"))
    return row | {"ratio": None, "per_s": len(taken) / float(np.sum([own for _, own in taken]))}


def _answered(localiser: Localiser, text: bytes) -> None:
    localiser.apply(text)
    wire.encode(localiser.locate().matches)


def _peer(scope: str, homes: Homes, seen: Sequence[Seen], whole_ms: float) -> Row:
    """The peer at answers spread evenly over all."""
    by, config = original_clipper(), ClipperConfig()
    register = by or register_clipper
    known = [home.object_classes >= 0 for home in homes.arrays]
    mapped = [(a.object_positions[k], a.object_classes[k]) for a, k in zip(homes.arrays, known, strict=True)]

    def registered(one: Seen) -> None:
        for objects, classes in mapped:
            register(one.objects, one.classes, objects, classes, config)

    took: Times = {}
    taken: list[tuple[float, float]] = []
    for at in np.unique(np.linspace(0, len(seen) - 1, min(PEER_ANSWERS, len(seen))).round().astype(np.int64)).tolist():
        clocked(took, "", partial(registered, seen[at]))
        taken.append(took[""])
    return _row(scope, PEER if by is None else ORIGINAL, taken, whole_ms / 1e3)


def _row(scope: str, method: str, seconds: Sequence[tuple[float, float]], first: float) -> Row:
    times = np.array(seconds)
    return {**timed_row(scope, method, times, first), "cpu_p99_ms": 1e3 * float(np.percentile(times[:, 1], 99))}
