"""``semloc evaluate shortlist``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from semloc_core.cli.shared.common import Json, Seed, console, progress, write_json
from semloc_core.cli.shared.screen import print_pivot

if TYPE_CHECKING:
    from semloc_core.evaluate import Town

RootOrNone = Annotated[
    Path | None, typer.Argument(metavar="[ROOT]", help="Buildings of files instead: ROOT/*/map.json and query.json.")
]
Distractors = Annotated[
    list[Path] | None,
    typer.Option(
        "--distractors", metavar="DIR", help="With ROOT, in the map too: DIR/*.json and */map.json; several times."
    ),
]
Kind = Annotated[Literal["home", "coco_office", "office"], typer.Option(help="Kind of building.")]
Buildings = Annotated[int, typer.Option(min=1, help="How many are in the map.")]
Plans = Annotated[int, typer.Option(min=0, help="So many plans that they share, as flats do; 0: no two are alike.")]


def drawn_or_read(
    root: Path | None, distractors: list[Path] | None, kind: str, buildings: int, plans: int, seed: int
) -> Town:
    """The buildings that were asked for."""
    from semloc_core.evaluate import drawn_town, read_town

    return drawn_town(kind, buildings, plans, seed=seed) if root is None else read_town(root, distractors or [])


def shortlist(
    root: RootOrNone = None,
    distractors: Distractors = None,
    kind: Kind = "home",
    buildings: Buildings = 150,
    plans: Plans = 0,
    walks: Annotated[int, typer.Option(min=1, help="Walks through each building.")] = 2,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """How often the robot's building is among the few that it answers from, in a large map.

    The map is of generated buildings, each seen again by a detector from good to bad, or of files.
    """
    from semloc_core.evaluate import evaluate_shortlist
    from semloc_core.metrics import shortlist_pivots

    with progress("walking") as bar:
        bar(0, buildings, "buildings")
        town = drawn_or_read(root, distractors, kind, buildings, plans, seed)
        rows = evaluate_shortlist(town, walks=walks, seed=seed, progress=bar)
    console.print(f"{len(town.maps)} buildings in the map; columns are metres walked", markup=False)
    for pivot in shortlist_pivots(rows):
        print_pivot(pivot, console)
    if json_file is not None:
        inputs = [] if root is None else [root, *(distractors or [])]
        write_json(json_file, "evaluate shortlist", seed, inputs, rows)
