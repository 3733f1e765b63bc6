"""``semloc evaluate merge``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import Json, Seed, console, progress, write_json
from semloc_core.errors import ConfigError

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.evaluate import Case
    from semloc_core.graph import Labelspace

ENCODERS = ("rings", "bag_of_words")


def merge(
    root: Annotated[
        Path | None, typer.Argument(metavar="[ROOT]", help="Folder of buildings: ROOT/*/map.json and query.json.")
    ] = None,
    worlds: Annotated[int, typer.Option(min=0, help="Without ROOT: this many generated offices.")] = 20,
    traversals: Annotated[int, typer.Option(min=1, max=20, help="Traversals that are merged.")] = 3,
    distance_m: Annotated[
        float | None, typer.Option("--metres", min=0.0, help="How far each of them walks; 0: it sees all.")
    ] = None,
    mobility_m: Annotated[
        float, typer.Option(min=0.01, help="Generated offices: the larger, the less is carried about, m.")
    ] = 1.0,
    model: Annotated[
        list[Path] | None, typer.Option("--model", metavar="MODEL", help="Evaluate this trained model instead.")
    ] = None,
    train: Annotated[
        list[str] | None,
        typer.Option("--train", metavar="ENCODER", help="Train this encoder on the first traversals, and evaluate it."),
    ] = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """success@1 on a traversal to come, before and after earlier ones are merged into the map.

    Also how many traversals are laid right, whether those of another building are refused, and how mobile each class
    was found to be.
    """
    from semloc_core.evaluate import LifeConfig, evaluate_merge, home_cases, world_cases
    from semloc_core.metrics import print_table

    if root is None and worlds == 0:
        raise ConfigError("expected a ROOT or some --worlds (got neither)")
    metres = distance_m if distance_m is not None else 150.0 if root is None else 0.0
    life = LifeConfig(traversals=traversals, distance_m=metres, mobility_m=mobility_m)
    space, cases = world_cases(worlds, seed, life) if root is None else home_cases(root, seed, life)
    with progress("merging") as bar:
        rows = evaluate_merge(space, cases, _models(space, cases, model, train, seed), seed=seed, progress=bar)
    title = str(root) if root is not None else f"{worlds} generated offices"
    print_table([row for row in rows if "map" in row], title=title, console=console)
    print_table([row for row in rows if "tried" in row], title="traversals laid, and refused", console=console)
    if classes := [row for row in rows if "moves_learnt" in row]:
        print_table(classes, title="share that moves from one traversal to the next", console=console)
    if json_file is not None:
        write_json(json_file, "evaluate merge", seed, [root] if root is not None else [], rows)


def _models(
    space: Labelspace, cases: list[Case], files: list[Path] | None, train: list[str] | None, seed: int
) -> list[tuple[str, Model]]:
    """Models by name: those given, trained here, or encoders with nothing to train."""
    from semloc_core.encoding import Model, build_encoder
    from semloc_core.training import train as fit
    from semloc_core.training import train_config

    found: list[tuple[str, Model]] = []
    for path in files or []:
        loaded = Model.load(path)
        if loaded.labelspace.hash != space.hash:
            raise ConfigError(f"expected a model of the buildings' {len(space)} classes (got {path}, of others)")
        found.append((f"{loaded.encoder.name} {loaded.hash[:8]}", loaded))
    for name in train or []:
        found.append((name, fit([case.first for case in cases], space, train_config(name, seed=seed)).model))
    return found or [(name, Model(build_encoder(name, None, len(space)), space)) for name in ENCODERS]
