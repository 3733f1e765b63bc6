"""One update with its answer put to the test by layout, as a node answers: where the time goes, on two kinds of map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter, thread_time
from typing import TypeVar

import numpy as np
import torch

from semloc_core import wire
from semloc_core.benchmark.case import TEMPERATURE, BenchCase
from semloc_core.benchmark.timing import timed_row
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Model, build_encoder, embed_graph
from semloc_core.graph import GraphArrays, SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, stored_building
from semloc_core.matching import Located, confidence, fragment_of_graph, most_similar
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import KINDS, SimulationConfig, draw_pair, simulate_traversal
from semloc_core.text import short_repr

T = TypeVar("T")
Times = dict[str, tuple[float, float]]

TEST = "test by layout"
PARTS = ("surroundings", "places proposed", "headings", "alignment", "confidence")
OFFICE_PLACES, HOMES_PLACES = 1_500, 5_000


@short_repr
@dataclass(frozen=True, eq=False)
class Walked:
    """A map with its scene graphs, and a run through one of its buildings as JSON text."""

    scope: str
    loaded: LoadedMap
    updates: Sequence[bytes]


def bench_verified(
    case: BenchCase,
    rounds: int = 1,
    homes: int = HOMES_PLACES,
    distance_m: float = 60.0,
    progress: Progress = no_progress,
) -> list[Row]:
    """Time updates whose answers are put to the test, on the office and on many generated homes in one map.

    Args:
        case: the office.
        rounds: how often each run is walked, the first time untimed besides.
        homes: how many places the map of homes has at least.
        distance_m: how far the run through one of them goes.
        progress: told of every map.

    Returns:
        For each map: the whole update, unexplained; the test, and its parts; ``ratio`` is the row's own CPU time over
        the whole update's. ``cpu_p99_ms`` is the thread's own time that one in a hundred takes longer than.

    """
    rows: list[Row] = []
    for number, walked in enumerate((office(case), many_homes(homes, case.model.seed, distance_m))):
        progress(number, 2, walked.scope)
        localiser = Localiser(walked.loaded, LocaliserConfig(explain_rate_hz=0.0, max_update_bytes=2**28))
        taken: list[Times] = []
        for round_ in range(rounds + 1):
            for text in walked.updates:
                took = _one_update(localiser, text)
                # A full update is rare, and as large as the graph.
                if round_ and took is not None and b'"full":true' not in text[:400]:
                    taken.append(took)
        whole = float(np.median([took["all"][1] for took in taken]))
        methods = {"all": "semloc, verified, unexplained", TEST: f"· {TEST}", **{part: f"· · {part}" for part in PARTS}}
        for name, method in methods.items():
            times = np.array([took[name] for took in taken])
            row = timed_row(walked.scope, method, times, whole)
            rows.append({**row, "cpu_p99_ms": 1e3 * float(np.percentile(times[:, 1], 99))})
    return rows


def _one_update(localiser: Localiser, text: bytes) -> Times | None:
    """Seconds (clock, own) of one update and of its test; None where nothing was put to the test."""
    took: Times = {}

    def clocked(name: str, work: Callable[[], T]) -> T:
        wall, own = perf_counter(), thread_time()
        result = work()
        took[name] = (perf_counter() - wall, thread_time() - own)
        return result

    located = clocked("all", lambda: _answered(localiser, text))
    query, graph, reranker = located.query, localiser.live.stream.graph, localiser._reranker
    if query.place is None or query.encoded is None or graph is None or reranker is None:
        return None
    place, verifier, labelspace = query.place, reranker._verifier, localiser.map.model.labelspace
    z, top_n = query.encoded.embedding[0].numpy(), localiser.config.top_n
    raw, similarity = most_similar(localiser.map, z, top_n, localiser._index)
    # The test once more, whole and in its parts.
    tested = clocked(TEST, lambda: reranker.rank(graph, place, similarity, raw.rows, top_n))
    if tested is None:
        return None
    fragment = clocked(PARTS[0], lambda: fragment_of_graph(graph, labelspace, place, verifier.config))
    candidates = clocked(PARTS[1], lambda: verifier.candidates(fragment, similarity))
    rows, heading = clocked(PARTS[2], lambda: verifier.poses(fragment, candidates))
    verified = clocked(PARTS[3], lambda: verifier.tested(fragment, rows, heading))
    clocked(PARTS[4], lambda: confidence(verified, fragment, verifier.mapped))
    return took


def _answered(localiser: Localiser, text: bytes) -> Located:
    localiser.apply(text)
    located = localiser.locate()
    wire.encode(located.matches)
    return located


def office(case: BenchCase, n_places: int = OFFICE_PLACES) -> Walked:
    """The office's map with its scene graphs."""
    graph = case.arrays.to_scene_graph(case.model.labelspace)
    return Walked(
        f"verified update, offices of {n_places:,} places",
        with_graphs(case.map_of(n_places), lambda _: graph),
        case.updates,
    )


def many_homes(n_places: int, seed: int, distance_m: float) -> Walked:
    """Generated homes in one map, and a run through the first as a detector saw it another day."""
    rng = np.random.default_rng(seed)
    graphs: list[SceneGraph] = []
    while sum(len(graph.places) for graph in graphs) < n_places:
        mapped, again = draw_pair(KINDS["home"], rng)
        graphs.append(mapped.graph)
        if len(graphs) == 1:
            labelspace, run = mapped.labelspace, again.graph
    encoder = build_encoder("paper", None, len(labelspace), torch.Generator().manual_seed(seed)).eval()
    model = Model(encoder, labelspace, seed=seed, temperature=TEMPERATURE)
    arrays = [GraphArrays.from_scene_graph(graph, labelspace, f"home {i:05d}") for i, graph in enumerate(graphs)]
    loaded = LoadedMap(
        name="homes",
        hash="0" * 64,
        model=model,
        buildings=tuple(each.name for each in arrays),
        place_ids=tuple(place for each in arrays for place in each.place_ids),
        positions=np.concatenate([each.place_positions for each in arrays]),
        building_index=np.repeat(np.arange(len(arrays), dtype=np.int32), [each.n_places for each in arrays]),
        embeddings=np.concatenate([embed_graph(model, each) for each in arrays]),
    )
    config = SimulationConfig(distance_m=distance_m, range_m=10.0)
    steps = simulate_traversal(run, config, np.random.default_rng(seed + 1))
    return Walked(
        f"verified update, {len(graphs)} homes of {loaded.n_places:,} places",
        with_graphs(loaded, lambda number: graphs[number]),
        tuple(wire.encode(step.update) for step in steps),
    )


def with_graphs(loaded: LoadedMap, graph_of: Callable[[int], SceneGraph]) -> LoadedMap:
    """A map with the scene graphs of its buildings, by number."""
    ids = [loaded.place_ids[loaded.rows_of(name)] for name in loaded.buildings]
    stored = [stored_building(name, graph_of(i), ids[i], {}) for i, name in enumerate(loaded.buildings)]
    return replace(loaded, stored=tuple(stored))
