"""What `semloc bench` times, as cases of pytest-benchmark (``pytest tests/benchmarks --benchmark-only``).

Without that option only what does not depend on speed is looked at: rows are complete, and peers agree.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from killing import Calls

from semloc_core import wire
from semloc_core.benchmark import timing
from semloc_core.benchmark.case import BenchCase, make_bench_case
from semloc_core.benchmark.explain import Peer
from semloc_core.benchmark.growth import corridor
from semloc_core.benchmark.search import bench_search
from semloc_core.benchmark.timing import Contender, by_turns
from semloc_core.benchmark.train import bench_train, peer_embeddings
from semloc_core.benchmark.updates.steps import STEPS, bench_steps
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.encoding.place_graph import extract_all
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database.search.exact import ExactSearch
from semloc_core.report.growth_figure import growth_picture


@pytest.fixture(scope="module")
def case() -> BenchCase:
    return make_bench_case(distance_m=5.0)


@pytest.fixture
def counted(monkeypatch):
    """What is clocked are calls made, not seconds: the same on every machine."""
    calls = Calls(float("inf"), lambda: None)

    def clock():
        return 1e-6 * calls.made

    monkeypatch.setattr(timing, "time", SimpleNamespace(perf_counter=clock, thread_time=clock))
    calls.begin()
    yield
    calls.end()


def test_contenders_are_measured_by_the_first_of_their_task():
    called = []
    rows = by_turns([Contender("t", name, lambda name=name: called.append(name)) for name in ("ours", "theirs")], 3)
    assert called == ["ours", "theirs"] * 4
    assert [row["method"] for row in rows] == ["ours", "theirs"]
    assert all(row["repeats"] == 3 and row["p50_ms"] <= row["p99_ms"] for row in rows)


def test_an_update_is_taken_apart_into_all_its_steps(case, counted):
    rows = bench_steps(case, sizes=(1_500,))
    assert [row["method"] for row in rows[2:-1]] == [f"· {step}" for step in STEPS]
    steps = sum(row["cpu_ms"] for row in rows[2:-1])
    assert 0.3 < steps / rows[0]["cpu_ms"] < 3.0


def test_search_and_training_have_their_peers(case):
    assert bench_search(case, sizes=(2_000,), repeats=2)[0]["method"] == "semloc, exact"
    rows = bench_train(case, repeats=1)  # refuses peers that disagree
    assert [row["method"] for row in rows] == ["semloc", "PyG", "semloc", "PyG"]
    assert all(row["per_second"] > 0 for row in rows)


def test_growth_is_drawn():
    graph = SceneGraph.from_update(corridor(40, 7, ("a", "b")))
    assert (len(graph.places), len(graph.objects), graph.query_place in graph.places) == (40, 7, True)
    rows = [{"scope": "classes", "size": n, "cpu_ms": 1.0, "memory_mib": 2.0} for n in (1, 10)]
    assert growth_picture(rows).startswith(b"\x89PNG")


def test_update(benchmark, case):
    localiser = Localiser(case.map_of(1_500), LocaliserConfig(explain_rate_hz=1000.0))
    localiser.update(case.updates[0])
    full = wire.encode(localiser.live.stream.graph.to_update(0, 0, "map"))
    benchmark(localiser.update, full)


def test_search(benchmark, case):
    search = ExactSearch(case.map_of(100_000).embeddings)
    benchmark(search.search, case.embeddings[3], 10)


def test_embedding_a_building(benchmark, case):
    benchmark(embed_graph, case.model, case.arrays)


def test_embedding_a_building_by_pyg(benchmark, case):
    encoder = case.model.encoder
    batch = extract_all(case.arrays, encoder.n_classes, encoder.extraction)
    peer = Peer(encoder, torch.from_numpy(case.embeddings[0]))
    with torch.inference_mode():
        found = benchmark(peer_embeddings, peer, batch)
    assert np.abs(found.numpy() - case.embeddings).max() < 1e-5
