"""The words of the command ``semloc``: parse, call, print. Whatever it does can be had from the library as well."""

from __future__ import annotations

import logging
import sys
from typing import Annotated

import typer

from semloc_core import __version__
from semloc_core.cli import bags, bench, demo, explain, graph, introspect, replay, report, train, view, world
from semloc_core.cli.evaluate import commands as evaluate
from semloc_core.cli.maps import commands as maps
from semloc_core.cli.shared.absent import absent
from semloc_core.cli.shared.ending import unread
from semloc_core.cli.shared.inputs import guard
from semloc_core.cli.shared.outputs import App
from semloc_core.cli.shared.words import wrong_words
from semloc_core.errors import SemlocError

HELP = """Tells a robot where it is, and why it thinks so, from the semantics of a 3D scene graph.

A GRAPH is a Hydra scene-graph file (JSON, or .sparkdsg with spark_dsg installed).
A RUN is a bag: a recording of scene-graph updates (rosbag2 folder or .mcap).

A first day, in order (in place of `office.json` and `run.mcap`, your own Hydra file and recording):

    semloc world office -o office.json
    semloc map build office.json -o office.map
    semloc bag simulate office.json -o run.mcap
    semloc replay run.mcap --map office.map -o results.mcap
    semloc view results.mcap --run run.mcap --map office.map

Exit status: 0; 2 where words or files are wrong, with one line on stderr; 130 where it was stopped (143 by SIGTERM);
141 where the reader of its output went away, as `head` does.
"""

WRONG = 2
"""Exit status: wrong words or a wrong file, one line said on stderr."""
UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""click's, or that of typer's own copy of click."""

app = App(name="semloc", help=HELP, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode="markdown")


class _Once(logging.Filter):
    """A line is said once: some inputs are read twice."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is new."""
        text = record.getMessage()
        new = text not in self._said
        self._said.add(text)
        return new


def _version(value: bool) -> None:
    if value:
        typer.echo(f"semloc {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say more of what happens.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(_Once())
    level = logging.INFO if verbose else logging.WARNING
    logging.basicConfig(level=level, format="%(levelname)s: %(message)s", handlers=[handler])


app.command("demo")(demo.demo)
app.command("train")(train.train)
app.add_typer(maps.app, name="map")
app.add_typer(world.app, name="world")
app.add_typer(bags.app, name="bag")
app.add_typer(graph.app, name="graph")
app.command("replay")(replay.replay)
app.command("view")(view.view)
app.command("explain")(explain.explain)
app.command("introspect")(introspect.introspect)
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(report.app, name="report")
app.add_typer(bench.app, name="bench")


guard(app)


def run(words: list[str]) -> int:
    """Run the command line: its exit status. Whatever a person can get wrong becomes one line on stderr."""
    try:
        try:
            status = int(app(words, prog_name="semloc", standalone_mode=False) or 0)
        except UsageError as error:
            status = _wrong(_said(error, words))
        sys.stdout.flush()
    except SemlocError as error:
        status = _wrong(str(error))
    except BrokenPipeError:
        status = unread()
    except ModuleNotFoundError as error:
        status = _wrong(absent(error))
    except OSError as error:
        status = _wrong(f"{error.filename or 'input or output'}: {error.strerror or error}")
    except SystemExit as stop:
        # rich and click make this of a pipe that nobody reads any more.
        status = unread() if isinstance(stop.__context__, BrokenPipeError) else int(stop.code or 0)
    return status


def _said(error: Exception, words: list[str]) -> str:
    """What is wrong with the words of the command."""
    if type(error).__name__ == "NoArgsIsHelpError":  # the help is the answer; typer has printed it
        sys.exit(WRONG)
    return wrong_words(error, words, typer.main.get_command(app))


def _wrong(message: str) -> int:
    sys.stderr.write(f"semloc: {' '.join(message.split())}\n")
    return WRONG
