"""Options that several of the commands ``semloc evaluate …`` have."""

from pathlib import Path
from typing import Annotated

import typer

Root = Annotated[Path, typer.Argument(metavar="ROOT", help="Folder of buildings: ROOT/*/map.json and query.json.")]
Models = Annotated[list[Path] | None, typer.Option("--model", metavar="MODEL", help="Evaluate this trained model too.")]
Walks = Annotated[int, typer.Option(min=1, help="Walks a building, on average.")]
Verified = Annotated[bool, typer.Option("--layout/--no-layout", help="Answers verified by layout too.")]
