"""``semloc demo``: a run and a map that come with semloc; from an installed package too."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import console
from semloc_core.cli.shared.outputs import Force, Writes
from semloc_core.files import FOLDER

FILES = Path(str(resources.files("semloc_core.cli"))) / "demo_files"


def demo(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FOLDER", parser=Writes(FOLDER, in_place=True), help="Where results go."
        ),
    ] = Path("semloc_demo"),
    force: Force = False,
) -> None:
    """Replay a simulated run through a generated office against its map; results and a page go to a folder."""
    from semloc_core.cli.commands import run

    output.mkdir(parents=True, exist_ok=True)
    results, page, map_ = output / "results.mcap", output / "report.html", str(FILES / "office.map")
    again = ["--force"] if force else []
    console.print("A simulated run through a generated office:")
    replay = ["replay", str(FILES / "office_run.mcap"), "--map", map_, "-o", str(results)]
    for words in (
        [*replay, "--json", str(output / "figures.json"), *again],
        ["report", "replay", str(results), "--map", map_, "-o", str(page), *again],
    ):
        if status := run(words):
            raise typer.Exit(status)
    console.print(f"\nThe same in pictures: {page}", markup=False)
