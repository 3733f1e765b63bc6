"""``semloc view``."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.report import NodeOption, read_with_rivals
from semloc_core.cli.shared.common import (
    LabelspaceOption,
    RobotOption,
    SynonymsOption,
    ToleranceOption,
    TopicOption,
    console,
)
from semloc_core.cli.shared.map_places import only_a_file
from semloc_core.cli.shared.words import within
from semloc_core.config import LocaliserConfig, checked, options
from semloc_core.errors import ConfigError

_FILTER = next(option for option in options(LocaliserConfig) if option.name == "filter")


def view(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run, localised while you watch; or a bag of recorded answers.")
    ],
    map_file: Annotated[Path, typer.Option("--map", metavar="MAP", parser=only_a_file, help="The map file.")],
    updates: Annotated[
        Path | None, typer.Option("--run", metavar="RUN", help="Of recorded answers, the run that was answered.")
    ] = None,
    node: NodeOption = "/localiser",
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Where to listen; by default only this machine can look.")
    ] = "127.0.0.1",
    filter_: Annotated[
        str,
        typer.Option(
            "--filter",
            metavar="none|bayes",
            help=_FILTER.description,
            callback=within(lambda: LocaliserConfig, "filter"),
        ),
    ] = _FILTER.default,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port to listen on; 0: a free one.")] = 0,
    topic: TopicOption = None,
    robot: RobotOption = None,
    truth_tolerance: ToleranceOption = 0.05,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
) -> None:
    """Watch it think: the page of `semloc report replay` in a browser, live while a run is localised.

    Prints the page's address and serves it until Ctrl-C.
    """
    config = checked(LocaliserConfig, filter=filter_)
    import torch

    from semloc_core.map_database import load, reading_for
    from semloc_core.report import Feed, has_answers, live_page, replay_page, served
    from semloc_core.sources import Run

    torch.set_num_threads(1)
    loaded = load(map_file)
    reading = reading_for(loaded, labelspace, synonyms)
    if has_answers(run, node):
        if config.filter != _FILTER.default:
            raise ConfigError(f"expected --filter with a run that is localised now (got {run}, which has its answers)")
        data = read_with_rivals(run, loaded, updates, node, topic, robot, truth_tolerance, reading)
        with served(replay_page(data, loaded, run.name), None, host, port) as address:
            console.print(f"{address}  (Ctrl-C ends it)")
            threading.Event().wait()
    Run(run, topic=topic, robot=robot, reading=reading)  # what is no run is refused before a page is served
    feed = Feed(loaded, truth_tolerance, config)
    with served(live_page(loaded, run.name, config), feed, host, port) as address:
        console.print(f"{address}  (Ctrl-C ends it)")
        feed.run(run, reading, topic=topic, robot=robot)
        console.print("the run is over; the page stays")
        threading.Event().wait()
