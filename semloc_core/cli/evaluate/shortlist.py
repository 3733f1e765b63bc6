"""``semloc evaluate shortlist``."""

from __future__ import annotations

from typing import Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, progress, show


def shortlist(
    kind: Annotated[str, typer.Option("--kind", metavar="home|coco_office|office", help="Kind of building.")] = "home",
    buildings: Annotated[int, typer.Option("--buildings", min=1, help="How many are in the map.")] = 150,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """How often the robot's building is among the few that it answers from, in a large map of generated buildings."""
    from semloc_core.errors import ConfigError
    from semloc_core.evaluate import evaluate_shortlist
    from semloc_core.sources import KINDS

    if kind not in KINDS:
        raise ConfigError(f"expected --kind among {', '.join(KINDS)} (got {kind!r})")
    with progress("walking") as bar:
        rows = evaluate_shortlist(kind, buildings, seed=seed, progress=bar)
    show("evaluate shortlist", seed, [], rows, json_file, title=f"{buildings} buildings of kind {kind}")
