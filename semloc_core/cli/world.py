"""``semloc world``: buildings from a generator, for demo and tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import typer

from semloc_core.cli.shared.common import Seed, console, progress
from semloc_core.cli.shared.outputs import App, Writes, output_option
from semloc_core.cli.shared.screen import many as counted
from semloc_core.files import FOLDER, GRAPH

app = App(no_args_is_help=True, help="Generate buildings.")

GraphOutput = Annotated[Path, output_option("GRAPH", GRAPH, "Where to write the graph (JSON).")]


def _folder(kind: str, seed: int, number: int) -> str:
    return f"{kind}_{seed}_{number:03d}"


def _files(kind: str, seed: int, count: int, **_: object) -> Iterator[str]:
    """What `many` writes into its folder."""
    for i in range(count):
        yield from (f"{_folder(kind, seed, i)}/{name}.json" for name in ("map", "query"))


@app.command("office")
def office(output: GraphOutput, seed: Seed = 0) -> None:
    """An office with the paper's object counts (Table I) and about 1,300 places, as a Hydra v1.1 file."""
    import numpy as np

    from semloc_core.sources import OfficeConfig, make_office, write_world

    world = make_office(OfficeConfig(), np.random.default_rng(seed))
    write_world(output, world)
    console.print(f"{output}: {len(world.graph.places)} places, {len(world.graph.objects)} objects")


@app.command("home")
def home(output: GraphOutput, seed: Seed = 0) -> None:
    """A home with furniture of COCO's classes, drawn at random, as a Hydra v1.1 file."""
    import numpy as np

    from semloc_core.sources import KINDS, draw_pair, write_world

    world, _ = draw_pair(KINDS["home"], np.random.default_rng(seed))
    write_world(output, world)
    console.print(f"{output}: {len(world.graph.places)} places, {len(world.graph.objects)} objects")


@app.command("many")
def many(
    root: Annotated[
        Path,
        typer.Argument(
            metavar="ROOT",
            parser=Writes(FOLDER, files=lambda values: _files(**values), inside=GRAPH),
            help="Folder to write to: ROOT/*/map.json and query.json.",
        ),
    ],
    kind: Annotated[
        Literal["home", "coco_office", "office"],
        typer.Option(help="Homes or offices of COCO's classes, or offices of uHumans2's."),
    ] = "home",
    count: Annotated[int, typer.Option(min=1, max=10_000, help="How many buildings.")] = 12,
    plans: Annotated[
        int, typer.Option(min=0, help="So many plans that they share, as flats do; 0: no two are alike.")
    ] = 0,
    lacks: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of its plan's furniture that each lacks.")
    ] = 0.2,
    seed: Seed = 0,
) -> None:
    """Buildings of a kind, each mapped and seen again by a detector, as `semloc evaluate` reads them.

    No two are alike, or they are flats of a few plans.
    """
    import numpy as np

    from semloc_core.sources import KINDS, draw_flat, draw_pair, write_world

    places = 0
    with progress("building") as bar:
        for i in range(count):
            bar(i, count, kind)
            folder = root / _folder(kind, seed, i)
            folder.mkdir(parents=True, exist_ok=True)
            own = np.random.default_rng([seed, i])
            if plans:
                plan = np.random.default_rng([seed, i % plans, plans])
                mapped, seen = draw_flat(KINDS[kind], plan, own, lacks)
            else:
                mapped, seen = draw_pair(KINDS[kind], own)
            write_world(folder / "map.json", mapped)
            write_world(folder / "query.json", seen)
            places += len(mapped.graph.places)
    console.print(f"{root}: {counted(count, 'building')}, {places} places mapped")
