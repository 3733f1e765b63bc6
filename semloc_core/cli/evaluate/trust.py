"""``semloc evaluate trust``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.evaluate.options import Root, Walks
from semloc_core.cli.shared.common import Json, Seed, console, progress
from semloc_core.cli.shared.outputs import Writes
from semloc_core.files import FOLDER, PICTURE

if TYPE_CHECKING:
    from semloc_core.evaluate import Study

PICTURES = ("reliability", "success", "failure")
_HEAD = ("method", "scope", "building", "walk", "status", "probability")


def trust(
    root: Root,
    walks: Walks = 10,
    pictures: Annotated[
        Path | None,
        typer.Option(
            "--pictures",
            metavar="FOLDER",
            parser=Writes(FOLDER, files=lambda values: (f"{name}.png" for name in PICTURES), inside=PICTURE),
            help="Draw reliability.png, success.png and failure.png there.",
        ),
    ] = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """What answers along walks say of themselves, and, for each wrong one at 5 to 10 m, what misled it.

    The walks and answers are those of `semloc evaluate online` for rings + layout.
    """
    from semloc_core.evaluate import (
        calibration_rows,
        condition_rows,
        failures,
        status_rows,
        study_trust,
        threshold_rows,
    )
    from semloc_core.files import write_whole
    from semloc_core.metrics import document, print_table

    with progress("walking") as bar:
        study = study_trust(root, walks=walks, seed=seed, progress=bar)
    status, wrong = status_rows(study), failures(study)
    thresholds, conditions = threshold_rows(study), condition_rows(study)
    calibration = calibration_rows(study)
    print_table(status, title=str(root), console=console)
    print_table(calibration, title="probabilities, of the first place listed and of those after it", console=console)
    print_table(thresholds, title="accepted from a probability on", console=console)
    print_table(conditions, title="at 5 to 10 m", console=console)
    console.print(f"wrong at 5 to 10 m: {len(wrong)}")
    for row in wrong:
        figures = "; ".join(f"{name} {value}" for name, value in row.items() if name not in _HEAD and value is not None)
        head = f"{row['building']}, walk {row['walk']}, {row['scope']}: {row['status']}, p {row['probability']}"
        console.print(f"- {head}; {figures}", markup=False, highlight=False)
    if json_file is not None:
        write_whole(
            json_file,
            document("evaluate trust", seed, [str(root)], [*status, *calibration, *thresholds, *conditions, *wrong]),
        )
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        for name, picture in draw(study).items():
            write_whole(pictures / f"{name}.png", picture)


def draw(study: Study) -> dict[str, bytes]:
    """The pictures as PNG, by name; no failure where every answer is right."""
    from semloc_core.evaluate import reliability_points, success_points, worst
    from semloc_core.report import Plan, failure_figure, reliability_figure, success_figure, to_png

    spans = {"0 m walked": (0.0, 0.0), "2.5 to 10 m": (2.5, 10.0), "15 to 40 m": (15.0, 40.0)}
    curves = {
        name: reliability_points([judged for judged in study.answers if low <= judged.scope_m <= high])
        for name, (low, high) in spans.items()
    }
    found = {
        "reliability": to_png(reliability_figure(curves)),
        "success": to_png(success_figure(*success_points(study))),
    }
    laid = worst(study)
    if laid is not None:
        arena = study.arena
        here, there = (
            Plan.of(arena.maps[i].to_scene_graph(arena.labelspace), arena.maps[i].name)
            for i in (laid.judged.building, laid.there)
        )
        truth = laid.judged.truth[:2]
        found["failure"] = to_png(
            failure_figure(
                here, there, laid.path, truth, laid.answer, laid.seen_here, laid.seen_there, arena.labelspace.classes
            )
        )
    return found
