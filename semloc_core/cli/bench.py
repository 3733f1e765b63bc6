"""``semloc bench``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, console, progress, show
from semloc_core.cli.shared.outputs import App, Writes
from semloc_core.files import PICTURE, write_whole

if TYPE_CHECKING:
    from semloc_core.metrics import Row

app = App(help="Measure speed, side by side with the peers.")

Repeats = Annotated[int, typer.Option("--repeats", min=1, help="How often each contender is timed.")]
ABOUT = "ratio: a contender's CPU time over the first's of its task; one thread; p50_ms and p99_ms by the clock"


@contextmanager
def _peers() -> Iterator[None]:
    """Say which peer is missing; torch and BLAS on one thread."""
    from semloc_core.errors import ConfigError

    try:
        from semloc_core.benchmark import one_thread

        with one_thread():
            yield
    except ModuleNotFoundError as error:
        raise ConfigError(f"expected the peers, semloc[test], to be installed (got no {error.name})") from error


def _run(command: str, title: str, seed: int, json_file: Path | None, *parts: str) -> list[Row]:
    with _peers(), progress("timing") as bar:
        from semloc_core import benchmark

        case = benchmark.make_bench_case(seed)
        rows: list[Row] = []
        for part in parts:
            given = () if part == "explain" else (case,)
            rows += getattr(benchmark, f"bench_{part}")(*given, progress=bar)
    show(command, seed, [], rows, json_file, title=title)
    console.print(ABOUT)
    return rows


@app.callback(invoke_without_command=True)
def bench(context: typer.Context, seed: Seed = 0, json_file: Json = None) -> None:
    """Measure speed, side by side with the peers: everything in one table, or a part of it."""
    if context.invoked_subcommand is None:
        parts = ("update", "verified", "search", "train", "explain", "start")
        _run("bench", "semloc beside its peers, one thread", seed, json_file, *parts)


@app.command("update")
def update(seed: Seed = 0, json_file: Json = None) -> None:
    """One update, step by step, on maps of 1,500 to a million places, beside PyG's forward pass."""
    _run("bench update", "one update, with an attribution each time", seed, json_file, "update", "verified")


@app.command("search")
def search(seed: Seed = 0, json_file: Json = None) -> None:
    """Exact and approximate search of up to four million embeddings of 32 floats, beside faiss where it is there."""
    _run("bench search", "search", seed, json_file, "search")


@app.command("train")
def train(seed: Seed = 0, json_file: Json = None) -> None:
    """Embedding a building and training steps, beside PyG."""
    _run("bench train", "embedding and training", seed, json_file, "train")


@app.command("start")
def start(seed: Seed = 0, json_file: Json = None) -> None:
    """Start-up: imports, first answers, memory held."""
    _run("bench start", "start-up", seed, json_file, "start")


@app.command("growth")
def growth(
    seed: Seed = 0,
    json_file: Json = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", parser=Writes(PICTURE), help="Draw the curves.")
    ] = None,
) -> None:
    """Time and memory against map, graph, objects in reach and classes."""
    from semloc_core.report import growth_picture

    rows = _run("bench growth", "growth", seed, json_file, "growth")
    if plot is not None:
        write_whole(plot, growth_picture(rows))


@app.command("explain")
def explain(repeats: Repeats = 20, seed: Seed = 0, json_file: Json = None) -> None:
    """Explainers beside PyG's and Captum's: the same weights and graph, one thread, one run."""
    with _peers(), progress("timing") as bar:
        from semloc_core.benchmark import bench_explain

        rows = bench_explain(repeats, seed=seed, progress=bar)
    show("bench explain", seed, [], rows, json_file, title="explainers beside their peers, one thread")
    console.print("a hall of 30 places and 30 objects; ratio: median CPU time over semloc's")


@app.command("fleet")
def fleet(
    server: Annotated[
        str | None,
        typer.Option(
            "--server",
            metavar="URL",
            help="Measure this server, milvus+http://host:port/NAME; default: "
            "Milvus Lite, started for it. Maps homes_10, homes_200 … are made there, and dropped.",
        ),
    ] = None,
    sizes: Annotated[list[int] | None, typer.Option("--homes", min=1, help="Size of a map; several times.")] = None,
    robots: Annotated[list[int] | None, typer.Option("--robots", min=1, help="How many; several times.")] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, help="How long each is measured.")] = 10.0,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Robots with a map file each, and on one map server: answers a second, latency, CPU time, memory."""
    import tempfile

    with _peers(), progress("timing") as bar, tempfile.TemporaryDirectory() as folder:
        from semloc_core.benchmark import ROBOTS, SIZES, FleetServer, bench_fleet
        from semloc_core.fleet import parse_address

        address = parse_address(server) if server is not None else None
        with FleetServer(Path(folder) / "milvus", address) as running:
            rows = bench_fleet(Path(folder), running, sizes or SIZES, robots or ROBOTS, seconds, seed, bar)
    show("bench fleet", seed, [], rows, json_file, title="robots that share a map")
    console.print("per_s: answers of all robots together, which share one core here; cpu_ms: a robot's own work")
