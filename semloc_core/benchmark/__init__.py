"""Speed beside the peers: each step timed, and how it grows."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.benchmark.case import BenchCase, make_bench_case
    from semloc_core.benchmark.explain import bench_explain, one_thread
    from semloc_core.benchmark.fleet import ROBOTS, SIZES, bench_fleet
    from semloc_core.benchmark.growth import bench_growth
    from semloc_core.benchmark.map_server import FleetServer
    from semloc_core.benchmark.search import bench_search
    from semloc_core.benchmark.start import bench_start
    from semloc_core.benchmark.train import bench_train
    from semloc_core.benchmark.updates.by_buildings import PEER_UP_TO, bench_update
    from semloc_core.benchmark.updates.homes import Homes, generated_homes, real_homes
    from semloc_core.benchmark.updates.machine import one_core, this_machine
    from semloc_core.benchmark.updates.steps import bench_steps
else:
    __getattr__ = exports(__name__)

__all__ = [
    "BenchCase", "FleetServer", "Homes", "PEER_UP_TO", "ROBOTS", "SIZES", "bench_explain", "bench_fleet",
    "bench_growth", "bench_search", "bench_start", "bench_steps", "bench_train", "bench_update", "generated_homes",
    "make_bench_case", "one_core", "one_thread", "real_homes", "this_machine",
]  # fmt: skip
