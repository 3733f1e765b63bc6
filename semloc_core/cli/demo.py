"""``semloc demo``: a run with difficulties and a map that come with semloc; from an installed package too."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import typer

from semloc_core.cli.shared.common import console
from semloc_core.cli.shared.outputs import Force, Writes
from semloc_core.files import BAG, FIGURES, FOLDER, MAP, PAGE, Output

FILES = Path(str(resources.files("semloc_core.cli"))) / "demo_files"
WALK = ("--distance", "40", "--range", "8")
RESULTS, FIGURES_FILE, REPORT, MAP_FILE, RUN = "results.mcap", "figures.json", "report.html", "demo.map", "run.mcap"
WRITTEN = {RESULTS: BAG, FIGURES_FILE: FIGURES, REPORT: PAGE}
WRITTEN_OF_DATA = {MAP_FILE: MAP, RUN: BAG}
"""What is put into the folder, and of which kind it is; the second where a building is given."""


BEFORE = (
    "All simulated: a generated office, its twin with half of its furniture, and a run that starts in the dark, is "
    "carried elsewhere, then into the twin, and ends in a building that is not in the map."
)
AFTER = (
    "What was to be seen: no match in the dark, where next to nothing is seen; lost where it is carried off, and found "
    "again once it has seen what tells office and twin apart; and no match in the last building. That one is an office "
    "by the same generator: the little seen of it fits several places of the map somewhat, so the answers are "
    "ambiguous. They are unknown where it is likelier than not that the robot is in none of the map's buildings."
)


class Folder(Writes):
    """The folder, and what is put into it."""

    def outputs(self, name: str, value: Any, values: dict[str, Any]) -> Iterator[Output]:
        """What a value makes the command write."""
        yield Output(name, Path(value), FOLDER, in_place=True)
        for file, kind in (WRITTEN | ({} if values["data"] is None else WRITTEN_OF_DATA)).items():
            yield Output(name, Path(value) / file, kind, inside=True)


def demo(
    data: Annotated[
        Path | None, typer.Argument(metavar="[GRAPH]", help="Map and walk this building instead: a Hydra file.")
    ] = None,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FOLDER", parser=Folder(FOLDER), help="Where results go."),
    ] = Path("semloc_demo"),
    force: Force = False,
) -> None:
    """Replay a simulated run against a map; results, and a page that plays it, go to a folder."""
    from semloc_core.cli.commands import run

    output.mkdir(parents=True, exist_ok=True)
    results, page = str(output / RESULTS), str(output / REPORT)
    map_, bag = str(FILES / "demo.map"), str(FILES / "demo_run.mcap")
    made: list[list[str]] = []
    if data is None:
        console.print(BEFORE)
    else:
        console.print(
            f"A walk through {data}: the building is real, the walk and what the robot sees are simulated.",
            markup=False,
        )
        map_, bag = str(output / MAP_FILE), str(output / RUN)
        made = [["map", "build", str(data), "-o", map_], ["bag", "simulate", str(data), *WALK, "-o", bag]]
    made += [
        ["replay", bag, "--map", map_, "-o", results, "--json", str(output / FIGURES_FILE)],
        ["report", "replay", results, "--run", bag, "--map", map_, "-o", page],
    ]
    for words in made:
        if status := run([*words, *(["--force"] if force else [])]):
            raise typer.Exit(status)
    if data is None:
        console.print(f"\n{AFTER}")
    console.print(f"\nWatch it think, in a browser: {page}", markup=False)
