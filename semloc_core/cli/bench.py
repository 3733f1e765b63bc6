"""``semloc bench``."""

from __future__ import annotations

from typing import Annotated

import typer

from semloc_core.cli.common import Json, Seed, console, progress, show

app = typer.Typer(no_args_is_help=True, help="Measure speed, side by side with the peers.")


@app.callback()
def _bench() -> None:
    """Measure speed, side by side with the peers."""


@app.command("explain")
def explain(
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="How often each contender is timed.")] = 20,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Explainers beside PyG's and Captum's: the same weights and graph, one thread, one run."""
    from semloc_core.errors import ConfigError

    try:
        from semloc_core.evaluate.bench_explain import bench_explain

        with progress("timing") as bar:
            rows = bench_explain(repeats, seed=seed, progress=bar)
    except ModuleNotFoundError as error:
        raise ConfigError(f"expected the peers, semloc[test], to be installed (got no {error.name})") from error
    show("bench explain", seed, [], rows, json_file, title="explainers beside their peers, one thread")
    console.print("a hall of 30 places and 30 objects; ratio: median CPU time over semloc's")
