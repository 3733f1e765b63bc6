"""``semloc evaluate detections``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, progress, show


def detections(
    root: Annotated[Path, typer.Argument(metavar="ROOT", help="Folder of buildings: ROOT/*/query.json.")],
    map_file: Annotated[
        Path, typer.Option("--map", metavar="MAP", help="Their map: semloc map build ROOT/*/map.json.")
    ],
    walks: Annotated[int, typer.Option(min=1, help="Walks a building.")] = 4,
    metres: Annotated[float, typer.Option(min=1.0, help="Walked when it is asked.")] = 10.0,
    cameras: Annotated[int, typer.Option(min=1, max=16, help="Of the robot, 90° each.")] = 1,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Success and pose errors by simulated detections, beside the same walks as graphs of a mapper."""
    from semloc_core.evaluate import evaluate_detections
    from semloc_core.map_database import load

    loaded = load(map_file)
    with progress("walking") as bar:
        rows = evaluate_detections(root, loaded, walks=walks, metres=metres, cameras=cameras, seed=seed, progress=bar)
    show("evaluate detections", seed, [root, map_file], rows, json_file, f"{root}, by {map_file}")
