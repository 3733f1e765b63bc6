"""``semloc evaluate shortlist``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, console, progress, write_json
from semloc_core.cli.shared.screen import print_pivot


def shortlist(
    root: Annotated[
        Path | None,
        typer.Argument(metavar="[ROOT]", help="Buildings of files instead: ROOT/*/map.json and query.json."),
    ] = None,
    distractors: Annotated[
        list[Path] | None,
        typer.Option(
            "--distractors", metavar="DIR", help="With ROOT, in the map too: DIR/*.json and */map.json; several times."
        ),
    ] = None,
    kind: Annotated[str, typer.Option("--kind", metavar="home|coco_office|office", help="Kind of building.")] = "home",
    buildings: Annotated[int, typer.Option("--buildings", min=1, help="How many are in the map.")] = 150,
    plans: Annotated[
        int, typer.Option(min=0, help="So many plans that they share, as flats do; 0: no two are alike.")
    ] = 0,
    walks: Annotated[int, typer.Option(min=1, help="Walks through each building.")] = 2,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """How often the robot's building is among the few that it answers from, in a large map.

    The map is of generated buildings, each seen again by a detector from good to bad, or of files.
    """
    from semloc_core.errors import ConfigError
    from semloc_core.evaluate import drawn_town, evaluate_shortlist, read_town
    from semloc_core.metrics import shortlist_pivots
    from semloc_core.sources import KINDS

    if kind not in KINDS:
        raise ConfigError(f"expected --kind among {', '.join(KINDS)} (got {kind!r})")
    with progress("walking") as bar:
        bar(0, buildings, "buildings")
        others = distractors or []
        town = drawn_town(kind, buildings, plans, seed) if root is None else read_town(root, others)
        rows = evaluate_shortlist(town, walks=walks, seed=seed, progress=bar)
    console.print(f"{len(town.maps)} buildings in the map; columns are metres walked", markup=False)
    for pivot in shortlist_pivots(rows):
        print_pivot(pivot, console)
    if json_file is not None:
        write_json(json_file, "evaluate shortlist", seed, [] if root is None else [root, *others], rows)
