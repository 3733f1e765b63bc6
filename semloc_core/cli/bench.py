"""``semloc bench``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, by_comma, console, progress, show, write_json
from semloc_core.cli.shared.outputs import App, Writes, output_option
from semloc_core.cli.shared.screen import print_pivot
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
    """Measure speed, side by side with the peers: all that takes minutes in one table, or a part of it."""
    if context.invoked_subcommand is None:
        parts = ("steps", "search", "train", "explain", "start")
        _run("bench", "semloc beside its peers, one thread", seed, json_file, *parts)


@app.command("steps")
def steps(seed: Seed = 0, json_file: Json = None) -> None:
    """One update by similarity alone, step by step, on maps of 1,500 to a million places, beside PyG's forward pass."""
    _run("bench steps", "one update, with an attribution each time", seed, json_file, "steps")


@app.command("update")
def update(
    buildings: Annotated[
        str, typer.Option("--buildings", metavar="N,…", help="How many generated homes a map has, by comma.")
    ] = "1,18,100,200,1000,10000",
    homes: Annotated[
        list[Path] | None,
        typer.Option(
            "--homes",
            metavar="ROOT",
            help="Real ones instead, all in one map: ROOT/NAME/map.json, and query.json to walk through; of further "
            "ROOTs DIR/*.json and */map.json, in the map only.",
        ),
    ] = None,
    peer_up_to: Annotated[
        int, typer.Option("--peer-up-to", min=0, help="CLIPPER too on maps of so many buildings at most; 0: not.")
    ] = 100,
    robots: Annotated[int, typer.Option(min=1, help="How many share the map and the core, by turns.")] = 32,
    metres: Annotated[float, typer.Option(min=1.0, help="How far each of three runs goes, m.")] = 40.0,
    plot: Annotated[Path | None, output_option("PNG", PICTURE, "Draw time against buildings.")] = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """An update with test, attribution and evidence by how many buildings the map has, on one core, beside CLIPPER.

    Homes beyond the first 200 are these with a fifth of their furniture gone and the rest elsewhere.
    """
    from semloc_core.metrics import update_pivots
    from semloc_core.report import update_picture

    sizes = _sizes(buildings)
    with _peers(), progress("timing") as bar:
        from semloc_core import benchmark

        before = benchmark.this_machine()
        if homes:
            made = benchmark.real_homes(homes, seed, metres, progress=bar)
            sizes = [len(made.buildings)]
        else:
            made = benchmark.generated_homes(max(sizes), seed, metres, progress=bar)
        with benchmark.one_core():
            rows = benchmark.bench_update(made, sizes, peer_up_to, robots=robots, progress=bar)
        after = benchmark.this_machine()
    about = f"one core of {before}; when done: {after.rpartition(', ')[2]}"
    console.print(f"{made.scope}, {about}; columns are buildings in the map", markup=False)
    for pivot in update_pivots(rows):
        print_pivot(pivot, console)
    if json_file is not None:
        inputs = [str(path) for path in homes or []]
        write_json(json_file, "bench update", seed, inputs, [{**row, "machine": about} for row in rows])
    if plot is not None:
        write_whole(plot, update_picture(rows))


def _sizes(words: str) -> list[int]:
    """Sizes of maps, by comma."""
    try:
        sizes = [int(word) for word in by_comma(words)]
    except ValueError:
        sizes = [0]
    if min(sizes) < 1:
        from semloc_core.errors import ConfigError

        raise ConfigError(f"expected --buildings of at least 1, by comma (got {words!r})")
    return sizes


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
