"""``semloc world``: buildings from a generator, for demo and tests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.common import Seed, console

app = typer.Typer(no_args_is_help=True, help="Generate a building.")


@app.command("office")
def office(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="GRAPH", help="Where to write the graph (JSON).")],
    seed: Seed = 0,
) -> None:
    """An office with the paper's object counts (Table I) and about 1,300 places, as a Hydra v1.1 file."""
    import numpy as np

    from semloc_core.world import OfficeConfig, make_office, write_world

    world = make_office(OfficeConfig(), np.random.default_rng(seed))
    write_world(output, world)
    console.print(f"{output}: {len(world.graph.places)} places, {len(world.graph.objects)} objects")
