"""``semloc report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import (
    LabelspaceOption,
    RobotOption,
    SynonymsOption,
    ToleranceOption,
    TopicOption,
    console,
    progress,
)
from semloc_core.cli.shared.map_places import only_a_file
from semloc_core.cli.shared.outputs import App, Writes
from semloc_core.files import PAGE, PICTURE, write_whole

if TYPE_CHECKING:
    from semloc_core.graph import Reading
    from semloc_core.map_database import LoadedMap
    from semloc_core.report import ReplayData

app = App(no_args_is_help=True, help="Make pages and pictures of what was measured; they open without a network.")

Results = Annotated[
    Path, typer.Argument(metavar="RESULTS", help="A bag of answers: written by `semloc replay -o`, or recorded.")
]
MapOption = Annotated[
    Path, typer.Option("--map", metavar="MAP", parser=only_a_file, help="The map file that answered.")
]
RunOption = Annotated[
    Path | None,
    typer.Option(
        "--run",
        metavar="RUN",
        help="The run that was answered: its ground truth, what was seen, and why not elsewhere.",
    ),
]
NodeOption = Annotated[
    str, typer.Option("--node", metavar="NAME", help="Name of the node; its answers are on NAME/matches.")
]

StudyOption = Annotated[
    Path | None,
    typer.Option(
        "--study", metavar="FILE", help="Put a study on the same page: what `semloc introspect --keep` wrote."
    ),
]


def read_with_rivals(
    results: Path,
    loaded: LoadedMap,
    run: Path | None,
    node: str,
    topic: str | None,
    robot: str | None,
    truth_tolerance: float,
    reading: Reading,
) -> ReplayData:
    """Recorded answers with what speaks for the rivals; arguments as of `semloc_core.report.read_results`."""
    from semloc_core.report import read_results

    with progress("what speaks for the rivals") as step:
        return read_results(
            results,
            loaded,
            run=run,
            node=node,
            topic=topic,
            robot=robot,
            truth_tolerance_s=truth_tolerance,
            reading=reading,
            progress=step,
        )


@app.command("replay")
def replay(
    results: Results,
    map_file: MapOption,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="HTML", parser=Writes(PAGE), help="Where to write the page.")
    ],
    study: StudyOption = None,
    run: RunOption = None,
    node: NodeOption = "/localiser",
    topic: TopicOption = None,
    robot: RobotOption = None,
    truth_tolerance: ToleranceOption = 0.05,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
) -> None:
    """One HTML page that plays a replay: time line, plan, what was seen and what explains it, why not elsewhere.

    It opens without a network. What speaks for the rivals is computed now, from the run: without --run (and unless the
    updates were recorded beside the answers) the page says what it lacks.
    """
    from semloc_core.map_database import load, reading_for
    from semloc_core.report import kept, replay_page

    beside = kept(study) if study is not None else None
    loaded = load(map_file)
    reading = reading_for(loaded, labelspace, synonyms)
    data = read_with_rivals(results, loaded, run, node, topic, robot, truth_tolerance, reading)
    text = replay_page(data, loaded, results.name, beside)
    write_whole(output, text.encode())
    console.print(f"{output}: {data.answers} answers, {len(text.encode()) / 1e3:.0f} kB")


@app.command("study")
def study(
    kept_file: Annotated[Path, typer.Argument(metavar="FILE", help="What `semloc introspect --keep` wrote.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="HTML", parser=Writes(PAGE), help="Where to write the page.")
    ],
) -> None:
    """One HTML page of a study of explanations."""
    from semloc_core.report import kept

    text = kept(kept_file).html()
    write_whole(output, text.encode())
    console.print(f"{output}: {len(text.encode()) / 1e3:.0f} kB")


@app.command("picture")
def picture(
    results: Results,
    map_file: MapOption,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="PNG", parser=Writes(PICTURE), help="Where to write the picture.")
    ],
    run: RunOption = None,
    node: NodeOption = "/localiser",
    topic: TopicOption = None,
    robot: RobotOption = None,
    truth_tolerance: ToleranceOption = 0.05,
) -> None:
    """One picture of a replay's clearest answer: floor plan, path, top match, and the classes that carried it."""
    from semloc_core.map_database import load
    from semloc_core.report import answer_picture, read_results

    loaded = load(map_file)
    content = answer_picture(
        read_results(results, loaded, run=run, node=node, topic=topic, robot=robot, truth_tolerance_s=truth_tolerance),
        loaded,
    )
    write_whole(output, content)
    console.print(f"{output}: {len(content) / 1e3:.0f} kB")
