"""The benchmark of fleets on a real server: every robot answers, and its rows say what they are of."""

import pytest

from semloc_core.benchmark.fleet import FILE, bench_fleet
from semloc_core.benchmark.map_server import FleetServer


def test_rows_of_file_and_server(tmp_path):
    pytest.importorskip("milvus_lite")
    with FleetServer(tmp_path / "milvus") as server:
        rows = bench_fleet(tmp_path, server, sizes=(2,), robots=(1, 3), seconds=0.2)
        assert [(row["method"], row["robots"]) for row in rows] == [
            (method, robots) for method in (FILE, "Milvus Lite") for robots in (1, 3)
        ]
        for row in rows:
            assert row["scope"] == "2 homes"
            assert row["answers"] >= row["robots"]
            assert 0 < row["p50_ms"] <= row["p99_ms"]
            assert row["cpu_ms"] > 0
            assert (row["server_ms"] is None) == (row["method"] == FILE)
            assert ("held_mib" in row) == (row["robots"] == 1)
        server.keep(tmp_path / "homes_2.map")  # again: what was there is replaced
