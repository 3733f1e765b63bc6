"""What the commands share: options, reading graphs and runs, progress, tables and figures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from semloc_core.cli.shared.outputs import Writes
from semloc_core.cli.shared.screen import console as console
from semloc_core.cli.shared.screen import note as note
from semloc_core.errors import FileFormatError
from semloc_core.files import FIGURES, write_whole

if TYPE_CHECKING:
    from semloc_core.graph import Reading, SceneGraph
    from semloc_core.sources import HydraFile


Seed = Annotated[int, typer.Option("--seed", min=0, max=2**63 - 1, help="Seed of everything random.")]
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", parser=Writes(FIGURES), help="Write the figures as JSON.")
]
LabelspaceOption = Annotated[
    str | None,
    typer.Option(
        "--labelspace",
        metavar="NAME|FILE",
        help="Classes, and what class numbers mean: a shipped name (uhumans2_office, uhumans2_apartment, coco, "
        "mpcat40) or a YAML file; default: what the graph file says, else the map or model.",
    ),
]

SynonymsOption = Annotated[
    Path | None,
    typer.Option(
        "--synonyms",
        metavar="FILE|auto",
        help="YAML that joins a detector's names or numbers to the map's: {synonyms: {sofa: couch, 7: bed}}; auto: a "
        "name that the map lacks is its class of the same kind, by what label sets have in common.",
    ),
]


TopicOption = Annotated[
    str | None,
    typer.Option(
        "--topic",
        metavar="TOPIC",
        help="Topic of a RUN's updates; default: /scene_graph, or the only one with updates.",
    ),
]
RobotOption = Annotated[
    str | None,
    typer.Option("--robot", metavar="NAME", help="Of several robots in one file, this one; default: the first."),
]
MethodsOption = Annotated[
    str | None, typer.Option("--methods", metavar="NAME,…", help="Explainers, by comma; default: all.")
]
ToleranceOption = Annotated[
    float,
    typer.Option("--truth-tolerance", metavar="S", min=0.0, help="How far the ground truth's stamp may be off, s."),
]


def by_comma(words: str) -> list[str]:
    """The names in a list such as ``rings, tfidf``."""
    return [name.strip() for name in words.split(",")]


def building_name(path: Path) -> str:
    """Name of the building a file holds: its stem, or its folder's name where the stem says only its role."""
    return path.resolve().parent.name if path.stem in ("map", "query", "graph", "dsg") else path.stem


def read_graph(path: Path, reading: Reading) -> HydraFile:
    """Read a GRAPH, or a RUN to its end, and say what had to be decided of its classes."""
    from semloc_core.sources import read_building

    if not path.exists():
        raise FileFormatError(f"expected a scene-graph file (got {path}, which does not exist)")
    file = read_building(path, reading)
    tell(path, file.decided)
    return file


def read_graph_or_run(path: Path, reading: Reading) -> SceneGraph:
    """The scene graph of a GRAPH, or that of a RUN at its end, and say what had to be decided of its classes."""
    return read_graph(path, reading).graph


def tell(where: Path, lines: Sequence[str]) -> None:
    """Say what had to be decided of a file's classes."""
    for line in lines:
        note(f"{where}: {line}")


LINE_EVERY_S = 15.0


@contextmanager
def progress(description: str) -> Iterator[Callable[[int, int, str], None]]:
    """A progress bar on stderr; call what it yields with (done, total, a few words).

    Where stderr is no terminal, a line every `LINE_EVERY_S` says how far it is.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    name, now = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[words]}", markup=False)
    columns = (name, BarColumn(), now, TimeElapsedColumn())
    screen = Console(stderr=True, markup=False, emoji=False, highlight=False)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task(description, total=None, words="")
        said = time.monotonic()

        def step(done: int, total: int, words: str = "") -> None:
            nonlocal said
            bar.update(task, completed=done, total=total, words=words)
            if not screen.is_terminal and time.monotonic() - said >= LINE_EVERY_S:
                said = time.monotonic()
                typer.echo(f"{description}: {done} of {total} {words}".rstrip(), err=True)

        yield step


def show(
    command: str,
    seed: int,
    inputs: Sequence[Path | str],
    rows: list[dict[str, Any]],
    json_file: Path | None,
    title: str,
) -> None:
    """Print rows as a table and, if asked, write the same rows as JSON."""
    from semloc_core.metrics import print_table

    print_table(rows, title=title, console=console)
    if json_file is not None:
        write_json(json_file, command, seed, inputs, rows)


def write_json(path: Path, command: str, seed: int, inputs: Sequence[Path | str], rows: list[dict[str, Any]]) -> None:
    """Write rows as JSON, with what they come from; the whole file or nothing."""
    from semloc_core.metrics import document

    write_whole(path, document(command, seed, [str(p) for p in inputs], rows))
