"""``semloc evaluate town``."""

from __future__ import annotations

from typing import Annotated

import typer

from semloc_core.cli.evaluate.shortlist import Buildings, Distractors, Kind, Plans, RootOrNone, drawn_or_read
from semloc_core.cli.shared.common import Json, Seed, progress, show


def town(
    root: RootOrNone = None,
    distractors: Distractors = None,
    kind: Kind = "home",
    buildings: Buildings = 150,
    plans: Plans = 0,
    walks: Annotated[int, typer.Option(min=1, help="Walks through each building.")] = 1,
    alone: Annotated[bool, typer.Option("--alone", help="Each building is a map of its own.")] = False,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """What a localiser that opens a large map answers along walks: right, by status, among rivals, how honest.

    The map is of generated buildings, each seen again by a detector, or of files. wrong_match: share of all answers
    that are matches and wrong; wrong_building: and in another building; rivals_right: of ambiguous answers those with
    the right place among the first match and the rivals; listed: the robot's building was among those looked at.
    """
    from semloc_core.evaluate import evaluate_town

    with progress("walking") as bar:
        bar(0, buildings, "buildings")
        made = drawn_or_read(root, distractors, kind, buildings, plans, seed)
        rows = evaluate_town(made, walks, alone, seed, progress=bar)
    inputs = [] if root is None else [root, *(distractors or [])]
    each = "each a map of its own" if alone else "in one map"
    show("evaluate town", seed, inputs, rows, json_file, title=f"{len(made.maps)} buildings, {each}")
